"""Aerodynamic coefficients from measured motion, and which terms of signals they consist of."""
