"""Equation error: regression on smoothed states."""
