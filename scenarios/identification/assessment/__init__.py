"""What stands beside an estimate: bounds it ran into, intervals, what it predicts."""
