"""Sweeps of a loop whose response and margins are known.

A loop whose response and margins are known flies with a sweep of its command; `flightid response`
estimates both from its records.

It may import `responses` and what stands below it, and of `sim` whatever flies. A new scenario is a
file in `catalog` with `kind = "sweep"`; another loop is a table in `declaration.py` and a branch in
`flight.py`.
"""
