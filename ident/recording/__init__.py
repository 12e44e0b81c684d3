"""Checks of the raw columns of a record, before any fit.

It may import `ident.statistics` and `sim`; of the vehicle it is told plain numbers
(`Expectations`). A new kind of fault is a file with a function from series to findings, a line in
`inspection.py`, its threshold with theory or a simulated null beside it, a test in
`tests/unit/ident/recording` that finds it and another in which it is absent. What is done about a
finding is decided in `scenarios/preparation/recording.py`.
"""
