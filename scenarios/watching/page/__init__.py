"""A page that follows a watch in the browser of the same machine."""
