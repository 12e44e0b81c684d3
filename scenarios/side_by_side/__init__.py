"""Studies side by side, from their folders alone."""
