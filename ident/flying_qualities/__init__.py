"""Modes, criteria and levels of flying qualities, stability margins, and state-space matrices.

May import `ident.frequency_response`, `ident.statistics`, `ident.estimate` and `sim`. A new
criterion is a function of parameters and their covariance. Its docstring cites the published source
of the limits, and its result says where values are outside the range of the source. The limits of
the levels, with their sources, are in ``handling_qualities.toml``.
"""
