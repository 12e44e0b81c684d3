"""Data compatibility in six degrees of freedom."""
