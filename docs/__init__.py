"""The scripts behind the documentation's pictures and outputs."""
