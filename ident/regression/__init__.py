"""Equation error: regression of measured rates on smoothed states.

Least squares need no integration and give starting values. Instrumental variables remove the bias
that the noise of the states causes.

The package may import `ident.statistics`, `ident.estimate` and `sim`. A new method to compute a
state from a record belongs in `state_histories.py`. It must refuse, by name, the states that it
cannot compute.
"""
