"""The closed loop by itself: flown against linear, and what the papers leave open of its margins."""
