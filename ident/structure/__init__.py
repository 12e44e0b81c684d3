"""Aerodynamic coefficients from measured motion, and the terms of their models.

``coefficients`` computes time histories of the coefficients with their noise. ``selection`` chooses
terms by stepwise regression or orthogonal functions. ``collinearity`` finds terms that the
maneuvers do not separate. The package imports `sim.aerodynamics`, `sim.maths` and `sim.errors`, but
no vehicle and no effect.
"""
