"""`flightid check`: what the kinematics alone say of the sensors."""
