"""Sensors and wires: readings that err in a way that no scale, lag, offset, drift or step
describes.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.signal import lsim

from tests.independent.flight import Flight, Vehicle
from tests.independent.foreign.simulator import Cause, Term
from tests.independent.recording import USUAL

WARMING = 5.0  # s
MOUNT_DAMPING = 0.08
# Hz between which a hum wanders, and the s that it takes there and back
LOWEST, HIGHEST, WANDERING = 2.0, 6.0, 17.0


def warmed(size: float, flight: Flight) -> Flight:
    """A gyro that was switched on late: its zero settles by ``size`` standard deviations with a
    time constant.
    """
    return flight.with_signal(
        "q", flight.q + size * USUAL["q"] * (1.0 - np.exp(-flight.time / WARMING))
    )


def gyro_warms(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    return Term(read=partial(warmed, size))


def deflected(size: float, flight: Flight) -> Flight:
    """A vane close to the moving surface reads ``size`` of its deflection."""
    return flight.with_signal("alpha", flight.alpha + size * flight.elevator)


def vane_feels_elevator(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    return Term(read=partial(deflected, size))


def swinging(frequency: float, flight: Flight) -> Flight:
    """A vane on a soft boom: a lightly damped second order at ``frequency`` Hz between the flow and
    the reading.
    """
    w = 2.0 * np.pi * frequency
    _, shown, _ = lsim(
        ([w**2], [1.0, 2.0 * MOUNT_DAMPING * w, w**2]), flight.alpha - flight.alpha[0], flight.time
    )
    return flight.with_signal("alpha", flight.alpha[0] + shown)


def vane_on_spring(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    return Term(read=partial(swinging, size))


def hummed(size: float, phases: tuple[float, float], flight: Flight) -> Flight:
    """A hum in the gyro's wire, ``size`` standard deviations high, whose frequency wanders to and
    fro as a sine of time.
    """
    middle, swing, pace = (
        0.5 * (LOWEST + HIGHEST),
        0.5 * (HIGHEST - LOWEST),
        2.0 * np.pi / WANDERING,
    )
    turned = (
        2.0 * np.pi * (middle * flight.time - swing / pace * np.cos(pace * flight.time + phases[0]))
        + phases[1]
    )
    return flight.with_signal("q", flight.q + size * USUAL["q"] * np.sin(turned))


def wandering_hum(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    first, second = rng.uniform(0.0, 2.0 * np.pi, 2)
    return Term(read=partial(hummed, size, (float(first), float(second))))


CAUSES = (
    # The zero of the gyro does drift; that the drift dies out within seconds a straight line over a
    # short record leaves open.
    Cause(
        "gyro-warms",
        "sigma",
        (2.0, 6.0, 15.0),
        gyro_warms,
        "sensor-step:q speed-variation",
        "q",
        right="sensor-drift:q",
    ),
    Cause(
        "vane-feels-elevator",
        "part",
        (0.08, 0.2, 0.5),
        vane_feels_elevator,
        "sensor-lag:alpha vane-offset sensor-scale:alpha",
        "alpha",
    ),
    Cause(
        "vane-on-spring",
        "Hz",
        (3.0, 1.8, 1.3),
        vane_on_spring,
        "sensor-lag:alpha sensor-delay:alpha vane-offset elastic-mode",
        "alpha",
    ),
    Cause(
        "wandering-hum",
        "sigma",
        (1.0, 3.0, 8.0),
        wandering_hum,
        "elastic-mode gust-turbulence",
        "q",
    ),
)
