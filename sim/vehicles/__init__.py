"""Equations of motion and built-in aircraft."""
