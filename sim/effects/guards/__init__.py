"""Guards: terms that no effect of the library stands for; a search that needs one has found
something it cannot name.
"""
