"""Coefficients of forces and moments as sums of terms that a vehicle file or a search names.

May import `sim.maths` and `sim.errors`. A new kind of factor goes into `terms.py`.
"""
