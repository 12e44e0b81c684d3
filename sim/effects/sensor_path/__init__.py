"""Effects between the vehicle and the record, one file for an effect or a family."""
