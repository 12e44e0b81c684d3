"""What flies a truth; never seen by the identification side."""
