"""Residual tests, coloured residuals, information."""
