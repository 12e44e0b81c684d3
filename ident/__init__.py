"""Estimators and their diagnostics; they see a model and a record, never a vehicle, an effect or
the truth.
"""
