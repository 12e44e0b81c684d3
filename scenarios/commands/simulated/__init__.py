"""Simulated flights whose records are files: hidden-effect scenarios, own models, flights by JSBSim."""
