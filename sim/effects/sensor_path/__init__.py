"""Effects between the vehicle and the record, one file each."""
