"""Aerodynamic coefficients from measured motion, and the terms of their models."""
