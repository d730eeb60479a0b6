"""Tool axis to rotary words and back."""
