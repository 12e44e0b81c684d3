"""Flights by JSBSim, a simulator that is not the project's: truths that share no equation with the
models here.

Truths that share no equation with `sim`: six degrees of freedom, the aircraft's own tables, engines
and actuators. JSBSim is an extra (`pip install 'flightid[jsbsim]'`).

Of `sim` it may import records, errors and maneuvers, never `vehicles`, `effects`, `declaration`,
`propagation` or `truth`; `import-linter` checks it. `tests/independent` has flights by JSBSim of
its own and stays apart: an examiner that imports nothing of the house. To add an aircraft's usual
condition, add its line to `CONDITIONS`; to add a fault, a key in `declaration.py`, `schema.py` and
`declaration.py`.
"""
