"""5-axis flank milling of free-form blades with conical tools, from STEP file to HEIDENHAIN program."""

__version__ = "0.1.0"
