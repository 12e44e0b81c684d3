"""Recursive estimators of one record.

May import `ident.bilinear_table`, `ident.estimate` and `sim`. Whole-record fits and banks of
filters are in other packages.

To add a filter: start from `filter_problem`, store its results with `HistoryKeeper`, and
return an Estimate with an outcome. Test it against `tests/oracles/kalman.py` on the linear problem.
"""
