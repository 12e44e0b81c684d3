"""Equation error: regression on smoothed states.

Equation error: measured rates on the equations of motion. Least squares need no integration and
give starts; instrumental variables take the bias of noise away.

May import `ident.statistics`, `ident.estimate` and `sim`.

To add a way to have a state from a record: in `state_histories.py`, with what it cannot do refused
by name.
"""
