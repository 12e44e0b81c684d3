"""Checks of the raw columns of a record, before any fit.

It may import `ident.statistics` and `sim`. What it needs of the vehicle is given as numbers
(`Expectations`). A new kind of fault needs a function that returns its findings, a call in
`inspection.py`, a threshold with its reason, and two tests in `tests/unit/ident/recording`: one
with the fault, one without. `scenarios/preparation/recording.py` decides what a finding causes.
"""
