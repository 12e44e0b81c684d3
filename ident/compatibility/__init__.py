"""Data compatibility: what the kinematics alone say of the sensors."""
