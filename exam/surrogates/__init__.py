"""Surrogate flights, which look measured: filtered, coloured, scattered and drifting signals,
with one dominant effect, two, or none.
"""
