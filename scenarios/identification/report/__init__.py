"""What is printed and written of an identification."""
