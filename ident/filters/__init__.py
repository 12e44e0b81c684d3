"""Recursive estimators of one record."""
