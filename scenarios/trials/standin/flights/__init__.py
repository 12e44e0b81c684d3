"""How a stand-in flies: aircraft, what is drawn, maneuvers, small causes, records."""
