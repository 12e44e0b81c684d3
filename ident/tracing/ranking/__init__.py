"""Sets that are near each other compared, and one of them chosen."""
