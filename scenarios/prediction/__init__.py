"""The model of a study on another record."""
