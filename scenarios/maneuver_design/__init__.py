"""Which maneuver to fly, before it is flown."""
