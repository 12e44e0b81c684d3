"""Modes of a whole axis of motion: Dutch roll, roll and spiral of a lateral one, short period and phugoid of a longitudinal one.

Roots of the equations about wings-level, level flight (Etkin and Reid, Dynamics of Flight, 3rd ed., sections 6.2 and 6.7). States that effects
add do not move: what is asked for are the modes of the airframe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.declaration.model import System
from sim.maths import complex_step_jacobian

LATERAL_STATES = ("beta", "p", "r", "phi")
LONGITUDINAL_STATES = ("airspeed", "alpha", "theta", "q")
TRIMMED_BY = ("elevator", "thrust")
TRIM_STEPS = 20
SETTLED = 1e-10
START_ALPHA = 0.05  # rad, from which the trim is looked for


def lateral_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """``dutch_roll_frequency`` (rad/s), ``dutch_roll_damping``, ``roll_time_constant`` and ``spiral_time_constant`` (s).

    A time constant is -1/root, negative where the mode grows; the time to half or double is its size times ln 2. Where roll and spiral are one
    oscillation, slower than the Dutch roll, they have no time constants. ``p`` are all parameters of the System.
    """
    roots = _roots(system, [0.0] * len(system.states), [0.0] * len(system.inputs), p, LATERAL_STATES)
    pairs, real = _pairs(roots), _real(roots)
    modes = _oscillation("dutch_roll", pairs[-1]) if pairs else {}
    if len(real) == 2 and pairs and np.all(real != 0.0):
        spiral, roll = sorted(real, key=abs)
        modes |= {"roll_time_constant": float(-1.0 / roll), "spiral_time_constant": float(-1.0 / spiral)}
    return modes


def longitudinal_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """``short_period_frequency``, ``phugoid_frequency`` (rad/s), ``short_period_damping`` and ``phugoid_damping`` at the reference airspeed.

    About level flight, for which angle of attack, elevator and thrust are solved; empty where there is none. A motion that does not oscillate
    is left out. ``p`` are all parameters of the System.
    """
    trim = level_flight(system, p)
    if trim is None:
        return {}
    roots = _roots(system, *trim, p, LONGITUDINAL_STATES)
    pairs, real = _pairs(roots), _real(roots)
    if len(pairs) == 2:
        return {**_oscillation("short_period", pairs[1]), **_oscillation("phugoid", pairs[0])}
    if len(pairs) == 1:
        slow = abs(pairs[0]) < np.max(np.abs(real))
        return _oscillation("phugoid" if slow else "short_period", pairs[0])
    return {}


def level_flight(system: System, p: np.ndarray) -> tuple[list[float], list[float]] | None:
    """States and inputs of steady level flight at the parameter ``reference_airspeed``; None where no elevator and thrust hold it."""
    states, inputs = list(system.state_names), list(system.input_names)
    if "reference_airspeed" not in system.parameters or not set(TRIMMED_BY) <= set(inputs):
        return None
    values, resting = p.tolist(), [states.index(name) for name in ("airspeed", "alpha", "q")]
    speed = values[system.parameters.index("reference_airspeed")]

    def flown(unknown: Sequence[float]) -> tuple[list[float], list[float]]:
        x, u = [0.0] * len(states), [0.0] * len(inputs)
        x[states.index("airspeed")] = speed
        x[states.index("alpha")] = x[states.index("theta")] = unknown[0]
        for name, value in zip(TRIMMED_BY, unknown[1:], strict=True):
            u[inputs.index(name)] = value
        return x, u

    def rates(unknown: Sequence[float]) -> list[float]:
        found = system.f(0.0, *flown(unknown), values)
        return [found[i] for i in resting]

    at = np.array([START_ALPHA, 0.0, 0.0])
    with np.errstate(all="ignore"):
        for _ in range(TRIM_STEPS):
            slope = complex_step_jacobian(rates, at.tolist())
            if not np.all(np.isfinite(slope)) or np.linalg.matrix_rank(slope / np.maximum(np.abs(slope).max(axis=0), 1e-300)) < len(at):
                return None
            step = np.linalg.solve(slope, np.array(rates(at.tolist()), dtype=float))
            at = at - step
            if np.all(np.abs(step) <= SETTLED * np.maximum(1.0, np.abs(at))):
                return flown(at.tolist())
    return None


def _roots(system: System, x: list[float], u: list[float], p: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Eigenvalues of the rates of the states ``names`` among themselves."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return np.linalg.eigvals(F) if np.all(np.isfinite(F)) else np.zeros(0)


def _pairs(roots: np.ndarray) -> list[complex]:
    """One root of each oscillation, the slowest first."""
    return sorted((complex(root) for root in roots if root.imag > 1e-9), key=abs)


def _real(roots: np.ndarray) -> np.ndarray:
    return np.array([root.real for root in roots if abs(root.imag) <= 1e-9])


def _oscillation(name: str, root: complex) -> dict[str, float]:
    return {f"{name}_frequency": abs(root), f"{name}_damping": -root.real / abs(root)}
