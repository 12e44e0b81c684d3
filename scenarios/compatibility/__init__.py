"""`flightid check`: sensor errors that kinematics alone reveal.

It may import `studies`, `preparation`, `plots`, `terminal`, `files` and `ident.compatibility`. A
new sensor fault belongs to `ident/compatibility`; here it gets its words in `report.py` and its key
in `report.py`.
"""
