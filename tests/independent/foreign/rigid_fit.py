"""How much of a cause shows: what the best rigid short period leaves over of its flights, noise
aside.

Output error by Gauss-Newton on the two records that are fitted, speed held constant, so that
nothing but the cause is left over.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from tests.independent.flight import G0, Flight, Vehicle
from tests.independent.foreign.catalogue import Case, flights_of
from tests.independent.recording import USUAL
from tests.independent.short_period import VEHICLES

SHOWN = ("alpha", "q", "nz")
STRIDE = 4  # of the fine grid: 50 Hz


def predicted(
    vehicle: Vehicle, derivatives: np.ndarray, elevator: np.ndarray, step: float
) -> np.ndarray:
    """alpha, q and nz - 1, an array (3, samples), of the linear short period from rest; CL and then
    Cm over alpha, q, elevator.
    """
    a, b, k = vehicle.lift_slope, vehicle.moment_slope, vehicle.rate_time
    lift, moment = (
        derivatives[:3] * np.array([1.0, k, 1.0]),
        derivatives[3:] * np.array([1.0, k, 1.0]),
    )
    matrix = np.array([[-a * lift[0], 1.0 - a * lift[1]], [b * moment[0], b * moment[1]]])
    entry = np.array([[-a * lift[2]], [b * moment[2]]])
    f, g, h, d, _ = cont2discrete((matrix, entry, np.eye(2), np.zeros((2, 1))), step, method="foh")
    # Two states as two filters: numerator by Cramer's rule over the common characteristic
    # polynomial.
    poles = np.array([1.0, -np.trace(f), np.linalg.det(f)])
    adjoint = np.array([[-f[1, 1], f[0, 1]], [f[1, 0], -f[0, 0]]])
    turned = adjoint @ g[:, 0]
    states = [
        lfilter(
            h[row] @ np.stack([np.zeros(2), g[:, 0], turned], axis=1) + d[row, 0] * poles,
            poles,
            elevator,
        )
        for row in range(2)
    ]
    load = a * vehicle.airspeed / G0 * (lift @ np.stack([*states, elevator]))
    return np.stack([*states, load])


def centred(values: np.ndarray) -> np.ndarray:
    """Each channel less its mean: every record and channel has a zero of its own."""
    return np.asarray(values - np.mean(values, axis=-1, keepdims=True))


def measured(flight: Flight) -> np.ndarray:
    """alpha, q and nz as `predicted` has them."""
    return np.stack([flight.alpha, flight.q, flight.nz - 1.0])[:, ::STRIDE]


def best_rigid(vehicle: Vehicle, flights: Sequence[Flight]) -> tuple[np.ndarray, list[np.ndarray]]:
    """The six derivatives that fit best, and what is left over of each flight (3, samples), in the
    unit of the channel.
    """
    sigma = np.array([USUAL[name] for name in SHOWN])[:, None]
    start = np.array(list(vehicle.derivatives.values()))

    def left(scale: np.ndarray) -> list[np.ndarray]:
        pairs = [
            (measured(one), predicted(vehicle, start * scale, one.elevator, one.step)[:, ::STRIDE])
            for one in flights
        ]
        return [centred(shown - said) for shown, said in pairs]

    def stacked(scale: np.ndarray) -> np.ndarray:
        return np.clip(np.concatenate([(one / sigma).ravel() for one in left(scale)]), -1e6, 1e6)

    found = least_squares(stacked, np.ones(6), x_scale=0.1, max_nfev=60)
    return start * found.x, left(found.x)


def seen_beside_rigid(
    case: Case, seed: int, much: float | None = None
) -> dict[str, tuple[float, float]]:
    """By channel, root mean square of what is left over: in standard deviations of the sensor, and
    as a part of the motion's.
    """
    flights = flights_of(case, seed, phugoid=False, much=much)[:2]
    _, left = best_rigid(VEHICLES[case.vehicle], flights)
    over = np.sqrt(np.mean(np.concatenate(left, axis=1) ** 2, axis=1))
    moved = np.sqrt(
        np.mean(np.concatenate([centred(measured(one)) for one in flights], axis=1) ** 2, axis=1)
    )
    return {
        name: (float(over[i] / USUAL[name]), float(over[i] / moved[i]))
        for i, name in enumerate(SHOWN)
    }
