"""Terms that only a truth has: no model is ever fitted with them. One term a file, found by being there."""
