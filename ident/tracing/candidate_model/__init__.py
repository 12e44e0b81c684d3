"""The declared model with a set of effects, fitted to all records."""
