"""Simulation of the truth; the identification packages never import it."""
