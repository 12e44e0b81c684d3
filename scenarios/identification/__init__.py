"""`flightid identify`: parameters from a measured record."""
