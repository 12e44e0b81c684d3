"""Inputs: steps, sweep, multisine."""
