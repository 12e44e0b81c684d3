"""Data compatibility in six degrees of freedom.

It may import `ident.statistics`, `sim` and the files of `ident.compatibility` other than
`check.py`.

A new sensor fault needs its kind in `ident/compatibility/kinematics.py`, an entry in `faults_of`
and its effect in `kinematics.py` of this folder, and an independent form of the effect in
`tests/oracles/six_degrees.py`. The tests in `tests/unit/ident/compatibility/six_degrees` then
include it.
"""
