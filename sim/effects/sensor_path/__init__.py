"""One file each: effects-sensor path."""
