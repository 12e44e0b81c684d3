"""Data compatibility in six degrees of freedom.

It may import `ident.statistics`, `sim` and the files of `ident.compatibility` other than
`check.py`.

To add a sensor fault: its kind in `ident/compatibility/kinematics.py`, its place in `faults_of` and
its effect in `kinematics.py` of this folder, and the effect once more in
`tests/oracles/six_degrees.py`. `tests/unit/ident/compatibility/six_degrees` then tries it.
"""
