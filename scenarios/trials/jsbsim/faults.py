"""Faults of sensors and surfaces, put into a flight afterwards: on the true signals at every frame, before sampling and noise.

A surface's fault lies between its record and the surface: the aircraft did what it did, and the record is what would have led to it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scenarios.trials.jsbsim.declaration import SURFACES, JsbsimFlight

Signals = Mapping[str, np.ndarray]
STILL = 1e-9  # rad of one frame, below which a surface stands


def spoiled(signals: Signals, flight: JsbsimFlight) -> dict[str, np.ndarray]:
    """The signals as the recorder is given them: vanes ahead, then late sensors, then surfaces that answer late or with play."""
    shown, time = dict(signals), signals["time"]
    if flight.vane_ahead:
        # A point ahead of the centre of gravity moves up in pitching up and to the right in yawing right.
        shown["alpha"] = shown["alpha"] - flight.vane_ahead * shown["q"] / shown["airspeed"]
        shown["beta"] = shown["beta"] + flight.vane_ahead * shown["r"] / shown["airspeed"]
    for name, half in flight.backlash.items():
        shown[name] = ahead_of_play(shown[name], half)
    for name, delay in flight.late.items():
        # What a surface does late was recorded early.
        shown[name] = np.interp(time + delay if name in SURFACES else time - delay, time, shown[name])
    return shown


def ahead_of_play(surface: np.ndarray, half: float) -> np.ndarray:
    """A drive that moves a surface just so through a play of ``half`` to either side.

    While the surface moves the drive is ``half`` ahead of it; while it stands, the drive crosses the play at its own pace, here evenly from one
    motion to the next. It begins in the middle.
    """
    moving = np.sign(np.where(np.abs(np.diff(surface)) > STILL, np.diff(surface), 0.0))
    at = np.flatnonzero(moving)
    if len(at) == 0:
        return surface.copy()
    # Frame k + 1 is reached by motion k.
    return np.asarray(surface + half * np.interp(np.arange(len(surface)), [0, *(at + 1)], [0.0, *moving[at]]))


def named(flight: JsbsimFlight) -> dict[str, dict[str, float]]:
    """What was put in, under the names of the library of effects where it has one."""
    found: dict[str, dict[str, float]] = {}
    for name, delay in flight.late.items():
        found[f"{'input' if name in SURFACES else 'sensor'}-delay:{name}"] = {"delay": delay}
    for name, half in flight.backlash.items():
        found[f"input-backlash:{name}"] = {"half_width": half}
    if flight.vane_ahead:
        found["vane-offset"] = {"arm": flight.vane_ahead}
    if flight.rough_air:
        found["gust-turbulence"] = {"class_of_exceedance": float(flight.rough_air)}
    return found
