"""Effects in the equations of motion, one file for an effect or a family."""
