"""Modes, frequency responses and handling-quality levels."""
