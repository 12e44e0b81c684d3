"""How a stand-in of the lateral axis flies."""
