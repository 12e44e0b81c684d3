"""Simulated flights whose records are files: tracing scenarios, stand-ins, own models, flights by JSBSim."""
