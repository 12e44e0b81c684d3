"""Recursive estimators of one record.

May import `ident.bilinear_table`, `ident.estimate` and `sim`. Whole-record fits and banks of
filters are in other packages.

To add a filter: start from `filter_problem`, keep what it does with `HistoryKeeper`, return its
Estimate with an outcome code; test it against `tests/oracles/kalman.py` on the linear problem.
"""
