"""Scores of campaigns of the tracing loop on flights with a known truth: verdicts, names with their
probabilities, and sigmas.
"""
