"""Data compatibility in six degrees of freedom.

It may import the other files of `ident.compatibility` but for its `check.py`, `ident.statistics`
and `sim`.

To add a sensor fault: its kind in `ident/compatibility/kinematics.py`, its place in
`kinematics.py`, what it does in `kinematics.py`, and in `tests/oracles/six_degrees.py` a second
time; `tests/unit/ident/compatibility/six_degrees` then tries it.
"""
