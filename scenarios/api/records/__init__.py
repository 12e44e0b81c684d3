"""Records in memory, and their way to and from the containers of other packages."""
