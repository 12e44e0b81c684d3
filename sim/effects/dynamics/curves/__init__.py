"""Coefficients and derivatives that are curves: of an angle, a control, the Mach number, or of any
signal.
"""
