"""Flights of simulators that share no code with the tracing loop, and grades of its answers."""
