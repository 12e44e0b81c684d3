"""Effects from outside the aircraft, one file each."""
