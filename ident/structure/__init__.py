"""Aerodynamic coefficients from measured motion, and the terms of their models.

May import `sim.aerodynamics`, `sim.maths` and `sim.errors`, but no vehicle and no effect.
"""
