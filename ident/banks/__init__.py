"""Banks of recursive filters, with many runs on one axis of the arrays."""
