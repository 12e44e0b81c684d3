"""Modes, criteria and levels of flying qualities, stability margins, and state-space matrices."""
