"""`flightid diagnose`: what the model lacks.

May import `identification`, `compatibility` and what is below them, and `ident.tracing`, which has
the search itself; what is known of an effect is in the effect's file in `sim/effects`.
"""
