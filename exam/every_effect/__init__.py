"""Every effect of the library planted in flights of its vehicles: how often the loop names it."""
