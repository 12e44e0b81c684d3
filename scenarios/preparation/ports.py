"""Names of the ports through which a measured flow enters the equations as recorded inputs."""

SPEED, DENSITY, LIFT = "airspeed_change", "density_change", "lift"
PORTS = (SPEED, DENSITY, LIFT)
