"""Flights by JSBSim, an independent simulator that shares no equation with `sim`.

JSBSim has six degrees of freedom, and tables, engines and actuators of each aircraft. It is an
extra (`pip install 'flightid[jsbsim]'`).

Of `sim` this package may import records, errors and maneuvers, never `vehicles`, `effects`,
`declaration`, `propagation` or `truth`; `import-linter` checks it. `tests/independent` has its own
flights by JSBSim and imports nothing from here. To add an aircraft's usual condition, add a line to
`CONDITIONS`; to add a fault, a key in `declaration.py` and in the schema of `flight.py`.
"""
