"""`flightid run`: simulate, identify, compare with the truth."""
