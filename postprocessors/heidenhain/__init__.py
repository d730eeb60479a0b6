"""Programs for HEIDENHAIN controls."""
