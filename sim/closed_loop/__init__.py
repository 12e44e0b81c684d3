"""The X-29-like closed loop: four airframes under a sampled control law, linear and with limits,
and its low-order equivalent.

May import: `sim.record`, `sim.errors`, `sim.data`, NumPy, SciPy, python-control.

To add: A number goes into the data file with unit and origin and into `airframe.py`; oracles in
`tests/oracles/x29_*.py` march the loop independently.
"""
