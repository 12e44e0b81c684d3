"""One file each: effects-disturbance."""
