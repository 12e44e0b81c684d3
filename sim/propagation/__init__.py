"""Time grids and integrators."""
