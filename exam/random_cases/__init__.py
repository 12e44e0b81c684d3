"""Cases of a random examination: flights drawn at random with hidden causes, and their scores."""
