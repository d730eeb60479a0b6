"""What the program is measured on."""
