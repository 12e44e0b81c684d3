"""What a user's own model can be asked before there is a record."""
