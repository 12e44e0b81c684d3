"""Signals that several vehicles share."""

from __future__ import annotations

from sim.declaration.effect import Signal

SHORT_PERIOD_OUTPUTS = (
    Signal("alpha", "rad", "angle of attack at the vane"),
    Signal("q", "rad/s", "pitch rate"),
    Signal("nz", "g", "normal load factor, positive up"),
)
GUST = Signal("gust", "rad", "upward gust over airspeed")
AIRSPEED_CHANGE = Signal("airspeed_change", "m/s", "airspeed above the declared one")
