"""One file each: effects."""
