"""Simulation of surrogate flights: aircraft, draws, maneuvers, small causes, records."""
