"""Modes, frequency responses and handling-quality levels.

May import `ident.frequency_response`, `ident.statistics`, `ident.estimate` and `sim`.

To add a criterion: a function of parameters and covariance, bounds from the published source cited
in its docstring, values outside the source's range told as such. Limits of the levels with
their sources are in `handling_qualities.toml`.
"""
