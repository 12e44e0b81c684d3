"""Terms of aerodynamic coefficients."""
