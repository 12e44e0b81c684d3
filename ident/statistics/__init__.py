"""Tests of residuals, covariances for coloured residuals, information matrices, intervals.

May import `ident.estimate` and `sim` only; every other package of `ident` may import this one.

To add a statistic: a function of arrays with its source in the docstring, and a test against a
textbook oracle or a simulated null.
"""
