"""`flightid diagnose`: what the model lacks."""
