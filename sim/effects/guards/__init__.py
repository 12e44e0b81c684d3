"""Catch-all terms (guards): loads and readings that no effect of the library has.

They compete like effects. If one is the most probable, nothing is claimed, since the cause is
unknown. A file has ``GUARDS``, whose names begin with ``guard:`` and whose traits have
``guard=True``. Its function ``made_for(equations)``, if it exists, makes the terms of a user model.
No file imports another effect.
"""
