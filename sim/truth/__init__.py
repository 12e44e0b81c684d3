"""Simulation of the truth; the identification packages never import it.

May import: Everything below in `sim`; not `sim.effects` or `sim.vehicles`.

To add: Randomness comes from the generator that is handed in and from nothing else: the same seed
gives the same bytes.
"""
