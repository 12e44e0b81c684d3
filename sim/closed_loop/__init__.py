"""The X-29-like closed loop: three airframes under a sampled control law, linear and with limits, and its low-order equivalent."""
