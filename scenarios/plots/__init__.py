"""Figures: pure functions that take results and return matplotlib Figures; the only modules that
import matplotlib.
"""
