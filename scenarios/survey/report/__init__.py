"""What a survey found, on a terminal, as files and as a page."""
