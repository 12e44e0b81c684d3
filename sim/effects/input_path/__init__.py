"""Effects between the recorded input and the vehicle, one file each."""
