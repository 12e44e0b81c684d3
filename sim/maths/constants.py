"""Numbers fixed by definition."""

G0 = 9.80665  # m/s2, standard gravity: the unit of nz
