"""Data that were not fitted: error figures and whiteness."""
