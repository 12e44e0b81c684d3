"""Aerodynamic coefficients from measured motion, and which terms of signals they consist of.

``coefficients`` forms histories with their noise, ``selection`` chooses terms by stepwise
regression or orthogonal functions, ``collinearity`` says what the maneuvers do not tell apart.
Imports `sim.aerodynamics`, `sim.maths` and `sim.errors`; no vehicle and no effect.
"""
