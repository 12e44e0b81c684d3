"""One file each: effects-dynamics."""
