"""Catch-all terms (guards): loads that no effect of the library has.

They compete like effects; if one is the most probable, nothing is claimed, since the cause is
unknown. A file has ``GUARDS``, whose names begin with ``guard:`` and whose traits have
``guard=True``. ``made_for(equations)`` of a file makes those of a user's model from its
declaration. No file imports another effect.
"""
