"""The page of a closed-loop scenario."""
