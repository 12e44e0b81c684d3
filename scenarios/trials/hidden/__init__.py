"""Terms that only a truth has: no model is ever fitted with them. One term a file, found by being
there.

One file a term, written like the effects of `sim/effects` but never offered to the loop.

They may import `sim` only. To add one that a scenario hides, write a file whose `TERM` is an effect
named `own:NAME`; `scenarios/trials/planted/declaration.py` finds it by that name. Those that no
scenario hides are in `exam/hidden_terms`.
"""
