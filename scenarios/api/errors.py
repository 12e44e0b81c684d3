"""The one exception for bad input."""

from __future__ import annotations

from sim.errors import FlightidError

# Its text is the one line that a command prints; `what`, `where` and `remedy` are its parts.
InputError = FlightidError
