"""Forward selection, backward elimination, near-aliases."""
