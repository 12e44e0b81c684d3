"""Checks of the raw columns of a record, before any fit."""
