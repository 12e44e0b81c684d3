"""Causes that the effect library does not have, for the examinations alone."""
