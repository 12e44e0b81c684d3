"""Effects that come out alike from record to record."""
