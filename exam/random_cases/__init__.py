"""Cases of an examination: flights drawn at random, what is hidden in them, and their scores."""
