"""A test campaign's records at once: each flight diagnosed and kept, then what recurs."""
