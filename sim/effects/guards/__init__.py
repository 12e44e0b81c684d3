"""Guards: terms that no effect of the library stands for; a search that needs one has found
something it cannot name.

They compete like effects; where one wins, nothing is claimed. A file has ``GUARDS``, whose names
begin with ``guard:`` and whose traits say ``guard=True``; ``made_for(equations)`` beside them makes
those of a user's own model from its declaration. No file imports another effect.
"""
