"""The X-29-like closed loop: four airframes under a sampled control law, linear and with limits, and its low-order equivalent."""
