"""One file each: vehicles."""
