"""Modes of an estimated model: frequencies, dampings and time constants, with bounds by linearisation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.whole_axes import LATERAL_STATES, LONGITUDINAL_STATES, lateral_modes, longitudinal_modes
from ident.statistics.information import variance_along
from sim.declaration.model import System
from sim.maths import complex_step_jacobian

MODAL_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "natural_frequency": "rad/s",
        "damping_ratio": "1",
        "dutch_roll_frequency": "rad/s",
        "dutch_roll_damping": "1",
        "roll_time_constant": "s",
        "spiral_time_constant": "s",
        "short_period_frequency": "rad/s",
        "short_period_damping": "1",
        "phugoid_frequency": "rad/s",
        "phugoid_damping": "1",
    }
)


def slowest_oscillation(system: System, p: np.ndarray, held: Collection[str] = ()) -> tuple[float, float] | None:
    """Undamped natural frequency (rad/s) and damping ratio of the slowest complex pair at rest; None if all roots are real, or there is no rest.

    For a short-period model this is the short period, also when elastic modes are present. ``held``: names of states that do not move,
    those of motion slower than what is asked for (a phugoid: its speed and attitude).
    """
    n, u = len(system.states), [0.0] * len(system.inputs)
    F = complex_step_jacobian(lambda x: system.f(0.0, x, u, p.tolist()), [0.0] * n)
    if not np.all(np.isfinite(F)):  # a model of totals may have no rest
        return None
    moving = [i for i, state in enumerate(system.states) if state.name not in held]
    roots = [root for root in np.linalg.eigvals(F[np.ix_(moving, moving)]) if root.imag > 1e-9]
    if not roots:
        return None
    slowest = min(roots, key=abs)
    return float(abs(slowest)), float(-slowest.real / abs(slowest))


def modal_estimate(system: System, estimate: Estimate, held: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """Modes with standard deviations, by name (``MODAL_UNITS``); those that the model does not have are left out.

    ``natural_frequency`` and ``damping_ratio`` of a short period; the modes of ``whole_axes`` where the states are those of a lateral or a
    whole longitudinal motion. Standard deviations by linearisation in the estimated parameters, as TM-101722 does for its figure 8.
    ``held`` as in ``slowest_oscillation``. Modes that no estimated parameter moves are left out: they are declared, not estimated.
    """
    names, centre, gradient = propagated(_modes_of(system, held), system, estimate)
    std = np.sqrt(variance_along(estimate.covariance, gradient))
    return {name: (float(value), float(sigma)) for name, value, sigma in zip(names, centre, std, strict=True) if sigma > 0.0}


def propagated(
    numbers: Callable[[np.ndarray], Mapping[str, float]], system: System, estimate: Estimate
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names and values ``(k,)`` of what follows from all parameters at an estimate, and its gradient ``(k, n)`` by the estimated ones.

    Central differences, to either side by a ten-thousandth of a sigma, or of the value where the sigma is larger; a number that is not there
    on both sides is left out.
    """
    p = system.parameters.values()
    index = [system.parameters.index(name) for name in estimate.names]
    p[index] = estimate.values
    centre = numbers(p)
    gradient = {name: np.zeros(len(index)) for name in centre}
    for column, (i, sigma) in enumerate(zip(index, estimate.std, strict=True)):
        size = min(sigma, abs(p[i])) if p[i] else min(sigma, 1.0)
        step = max(1e-4 * size, 1e-9 * abs(p[i]), 1e-300)
        above, below = (numbers(_moved(p, i, by)) for by in (step, -step))
        gradient = {name: row for name, row in gradient.items() if name in above and name in below}
        for name, row in gradient.items():
            row[column] = (above[name] - below[name]) / (2.0 * step)
    return tuple(gradient), np.array([centre[name] for name in gradient]), np.array([*gradient.values()]).reshape(len(gradient), len(index))


def _modes_of(system: System, held: Collection[str]) -> Callable[[np.ndarray], dict[str, float]]:
    """From all parameters to the modes of the system."""
    states = {state.name for state in system.states}
    if states.issuperset(LATERAL_STATES):
        return lambda p: lateral_modes(system, p)
    if states.issuperset(LONGITUDINAL_STATES):
        return lambda p: longitudinal_modes(system, p)

    def short_period(p: np.ndarray) -> dict[str, float]:
        found = slowest_oscillation(system, p, held)
        return {} if found is None else dict(zip(("natural_frequency", "damping_ratio"), found, strict=True))

    return short_period


def _moved(p: np.ndarray, i: int, by: float) -> np.ndarray:
    moved = p.copy()
    moved[i] += by
    return moved
