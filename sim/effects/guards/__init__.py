"""Catch-all terms (guards): loads of no effect in the library; a search that needs one has found an
unknown cause.

They compete like effects; if one is the likeliest, nothing is claimed. A file has ``GUARDS``, whose
names begin with ``guard:`` and whose traits say ``guard=True``; ``made_for(equations)`` beside them
makes those of a user's own model from its declaration. No file imports another effect.
"""
