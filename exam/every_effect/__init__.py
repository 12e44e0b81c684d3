"""Every effect of the library hidden in flights of its vehicles: how often the loop names it."""
