"""Score tests: what each candidate would add, without a fit."""
