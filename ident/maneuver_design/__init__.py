"""What a maneuver would tell before it is flown: standard deviations, and which of two effects acts."""
