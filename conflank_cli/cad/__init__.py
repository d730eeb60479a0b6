"""Reading parts and making the geometry that stages use."""
