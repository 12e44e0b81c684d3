"""How a surrogate flight flies: aircraft, what is drawn, maneuvers, small causes, records."""
