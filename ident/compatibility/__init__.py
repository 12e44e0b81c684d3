"""Data compatibility: check of the sensors by kinematics alone."""
