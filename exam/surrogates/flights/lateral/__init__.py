"""How a surrogate flight of the lateral axis flies."""
