"""Effects in the equations of motion, one file each."""
