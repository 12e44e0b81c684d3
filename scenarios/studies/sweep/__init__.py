"""The same flight with structures from stiff to soft."""
