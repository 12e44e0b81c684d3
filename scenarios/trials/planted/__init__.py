"""Scenarios with something undeclared in the data: flown here, traced on files alone, scored with
the truth.
"""
