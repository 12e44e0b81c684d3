"""The page that holds what two papers print against what the project finds."""
