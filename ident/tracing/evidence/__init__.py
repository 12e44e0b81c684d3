"""Posterior probabilities of sets of effects under one noise law with a discrepancy term."""
