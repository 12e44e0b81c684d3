"""The page that compares printed numbers of two papers with those of the project."""
