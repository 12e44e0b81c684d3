"""Figures of several studies, structures or methods beside each other."""
