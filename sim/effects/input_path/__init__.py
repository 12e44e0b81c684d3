"""One file each: effects-input path."""
