"""Design of maneuvers.

May import: `ident.maneuver_design`, `sim`, and of `scenarios` what lies below `diagnosis`.

To add a kind of maneuver: a function of a `ManeuverLimits` and a pulse width in `setting.py`, and
its name in `KINDS`; whoever can fly it names it in `limits.py`.
"""
