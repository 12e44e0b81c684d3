"""Reports: one typed document of a result, shown on a terminal, as a page and as JSON."""
