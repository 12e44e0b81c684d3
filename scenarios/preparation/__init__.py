"""Preparation of measured records: from the file to the fit."""
