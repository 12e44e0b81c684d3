"""A flight as it happened, on a fine grid and without noise: what both simulators hand to the
injected faults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

G0 = 9.80665  # m/s2, of the load factor


@dataclass(frozen=True, eq=False)
class Flight:
    """Signals at equal steps from time 0, SI and radians, nz in g positive up, elevator positive
    trailing edge down.

    ``alpha``, ``nz`` and ``elevator`` are totals or perturbations, whichever the simulator has; the
    c.g. is where ``nz`` is taken and where ``alpha`` is measured. ``trim_airspeed`` is the speed at
    the start.
    """

    step: float
    elevator: np.ndarray
    alpha: np.ndarray
    q: np.ndarray
    nz: np.ndarray
    theta: np.ndarray
    airspeed: np.ndarray
    trim_airspeed: float

    @property
    def time(self) -> np.ndarray:
        return self.step * np.arange(len(self.alpha))

    def signal(self, name: str) -> np.ndarray:
        """A signal by its column name."""
        values = getattr(self, name)
        assert isinstance(values, np.ndarray), name
        return values

    def with_signal(self, name: str, values: np.ndarray) -> Flight:
        assert values.shape == self.signal(name).shape, name
        changed: dict[str, Any] = {name: values}
        return replace(self, **changed)

    def rate_of(self, name: str) -> np.ndarray:
        """Time derivative by central differences of the fine grid, whose error is below 1e-5 of
        what a short period does.
        """
        return np.gradient(self.signal(name), self.step)


@dataclass(frozen=True)
class Vehicle:
    """What the vehicle file holds, SI, and the derivatives that are true about trim (rigid model,
    rates made non-dimensional with c/(2V)).
    """

    name: str
    mass: float
    wing_area: float
    chord: float
    pitch_inertia: float
    airspeed: float
    air_density: float
    derivatives: dict[str, float]

    @property
    def lift_slope(self) -> float:
        """rho V S/(2m), 1/s."""
        return self.air_density * self.airspeed * self.wing_area / (2.0 * self.mass)

    @property
    def moment_slope(self) -> float:
        """rho V^2 S c/(2 Iy), 1/s2."""
        return (
            self.air_density
            * self.airspeed**2
            * self.wing_area
            * self.chord
            / (2.0 * self.pitch_inertia)
        )

    @property
    def rate_time(self) -> float:
        """c/(2V), s."""
        return self.chord / (2.0 * self.airspeed)

    def short_period(self) -> tuple[float, float]:
        """Undamped frequency (rad/s) and damping ratio of the two-state model; a static instability
        gives frequency zero.
        """
        d, a, b, k = self.derivatives, self.lift_slope, self.moment_slope, self.rate_time
        matrix = np.array(
            [[-a * d["CL_alpha"], 1.0 - a * k * d["CL_q"]], [b * d["Cm_alpha"], b * k * d["Cm_q"]]]
        )
        squared = float(np.linalg.det(matrix))
        if squared <= 0.0:
            return 0.0, 1.0
        frequency = squared**0.5
        return frequency, -float(np.trace(matrix)) / (2.0 * frequency)
