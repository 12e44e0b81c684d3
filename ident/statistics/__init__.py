"""Residual tests, coloured residuals, information.

May import `ident.estimate` and `sim` only; every other room of `ident` may import this one.

To add one: a function of arrays with its source in the docstring, and a test against a textbook
oracle or a simulated null.
"""
