"""Modes of an estimated model: frequencies, damping ratios and time constants, with covariance.

Roots of the equations about wings-level, level flight (Etkin and Reid, Dynamics of Flight, 3rd ed.,
sections 6.2 and 6.7). States that effects add do not move: what is asked for are the modes of the
airframe.

A pair of roots is told by the coefficients of s^2 + rate s + stiffness, rate = 2 zeta omega and
stiffness = omega^2: they stay smooth where an oscillation becomes two real roots, and a Gaussian of
them is no Gaussian of damping and frequency. Levels of flying qualities are read from draws of
these numbers (``mode_levels``).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.statistics.intervals import variance_along
from sim.declaration.model import System
from sim.maths import G0, complex_step_jacobian

if TYPE_CHECKING:
    pass


# ---- Modes of a whole axis of motion

LATERAL_STATES = ("beta", "p", "r", "phi")
LONGITUDINAL_STATES = ("airspeed", "alpha", "theta", "q")
TRIMMED_BY = ("elevator", "thrust")
TRIM_STEPS = 20
SETTLED_SHARE = 1e-10
START_ALPHA = 0.05  # rad, from which the trim is looked for


def lateral_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """``dutch_roll_frequency`` (rad/s), ``dutch_roll_damping``, ``roll_time_constant`` and
    ``spiral_time_constant`` (s).

    A time constant is -1/root, negative where the mode grows; the time to half or double is its
    size times ln 2. Where roll and spiral are one oscillation, slower than the Dutch roll, they
    have no time constants. ``p`` are all parameters of the System.
    """
    roots = _roots(
        system, [0.0] * len(system.states), [0.0] * len(system.inputs), p, LATERAL_STATES
    )
    pairs, real = _pairs(roots), _real(roots)
    modes = _oscillation("dutch_roll", pairs[-1]) if pairs else {}
    if len(real) == 2 and pairs and np.all(real != 0.0):
        spiral, roll = sorted(real, key=abs)
        modes |= {
            "roll_time_constant": float(-1.0 / roll),
            "spiral_time_constant": float(-1.0 / spiral),
        }
    return modes


def longitudinal_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """``short_period_frequency``, ``phugoid_frequency`` (rad/s), ``short_period_damping`` and
    ``phugoid_damping`` at the reference airspeed.

    About level flight, for which angle of attack, elevator and thrust are solved; empty where there
    is none. A motion that does not oscillate is left out. ``p`` are all parameters of the System.
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
    """States and inputs of steady level flight at the parameter ``reference_airspeed``; None where
    no elevator and thrust hold it.
    """
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
        result = system.f(0.0, *flown(unknown), values)
        return [result[i] for i in resting]

    at = np.array([START_ALPHA, 0.0, 0.0])
    with np.errstate(all="ignore"):
        for _ in range(TRIM_STEPS):
            slope = complex_step_jacobian(rates, at.tolist())
            if not np.all(np.isfinite(slope)) or np.linalg.matrix_rank(
                slope / np.maximum(np.abs(slope).max(axis=0), 1e-300)
            ) < len(at):
                return None
            step = np.linalg.solve(slope, np.array(rates(at.tolist()), dtype=float))
            at = at - step
            if np.all(np.abs(step) <= SETTLED_SHARE * np.maximum(1.0, np.abs(at))):
                return flown(at.tolist())
    return None


def _roots(
    system: System, x: list[float], u: list[float], p: np.ndarray, names: Sequence[str]
) -> np.ndarray:
    """Return the eigenvalues of the rates of the states ``names`` among themselves."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return np.linalg.eigvals(F) if np.all(np.isfinite(F)) else np.zeros(0)


def _pairs(roots: np.ndarray) -> list[complex]:
    """Return one root of each oscillation, sorted by frequency."""
    return sorted((complex(root) for root in roots if root.imag > 1e-9), key=abs)


def _real(roots: np.ndarray) -> np.ndarray:
    return np.array([root.real for root in roots if abs(root.imag) <= 1e-9])


def _oscillation(name: str, root: complex) -> dict[str, float]:
    return {f"{name}_frequency": abs(root), f"{name}_damping": -root.real / abs(root)}


# ---- Modes of an estimated model

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


def slowest_oscillation(
    system: System, p: np.ndarray, fixed_states: Collection[str] = ()
) -> tuple[float, float] | None:
    """Undamped natural frequency (rad/s) and damping ratio of the slowest complex pair at rest;
    None if all roots are real, or there is no rest.

    For a short-period model this is the short period, also when elastic modes are present.
    ``fixed_states``: names of states held constant, those of slower motion than the wanted mode (a
    phugoid: its speed and attitude).
    """
    n, u = len(system.states), [0.0] * len(system.inputs)
    F = complex_step_jacobian(lambda x: system.f(0.0, x, u, p.tolist()), [0.0] * n)
    if not np.all(np.isfinite(F)):  # a model of totals may have no rest
        return None
    moving = [i for i, state in enumerate(system.states) if state.name not in fixed_states]
    roots = [root for root in np.linalg.eigvals(F[np.ix_(moving, moving)]) if root.imag > 1e-9]
    if not roots:
        return None
    slowest = min(roots, key=abs)
    return float(abs(slowest)), float(-slowest.real / abs(slowest))


def modal_estimate(
    system: System, estimate: Estimate, fixed_states: Collection[str] = ()
) -> dict[str, tuple[float, float]]:
    """Return the modes with standard deviations, by name (``MODAL_UNITS``); those that the model
    does not have are left out.

    ``natural_frequency`` and ``damping_ratio`` of a short period; the modes of ``whole_axes`` where
    the states are those of a lateral or a whole longitudinal motion. Standard deviations by
    linearisation in the estimated parameters, as TM-101722 does for its figure 8. ``fixed_states``
    as in ``slowest_oscillation``. Modes that no estimated parameter moves are left out: they are
    declared, not estimated.
    """
    names, centre, gradient = propagated(_modes_of(system, fixed_states), system, estimate)
    std = np.sqrt(variance_along(estimate.covariance, gradient))
    return {
        name: (float(value), float(sigma))
        for name, value, sigma in zip(names, centre, std, strict=True)
        if sigma > 0.0
    }


def propagated(
    numbers: Callable[[np.ndarray], Mapping[str, float]], system: System, estimate: Estimate
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return the names and values ``(k,)`` of what follows from all parameters at an estimate, and
    its gradient ``(k, n)`` by the estimated ones.

    Central differences, to either side by a ten-thousandth of a sigma, or of the value where the
    sigma is larger; a number that is not there on both sides is left out.
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
    return (
        tuple(gradient),
        np.array([centre[name] for name in gradient]),
        np.array([*gradient.values()]).reshape(len(gradient), len(index)),
    )


def _modes_of(
    system: System, fixed_states: Collection[str]
) -> Callable[[np.ndarray], dict[str, float]]:
    """Function from all parameters to the modes of the system."""
    states = {state.name for state in system.states}
    if states.issuperset(LATERAL_STATES):
        return lambda p: lateral_modes(system, p)
    if states.issuperset(LONGITUDINAL_STATES):
        return lambda p: longitudinal_modes(system, p)

    def short_period(p: np.ndarray) -> dict[str, float]:
        result = slowest_oscillation(system, p, fixed_states)
        return (
            {}
            if result is None
            else dict(zip(("natural_frequency", "damping_ratio"), result, strict=True))
        )

    return short_period


def _moved(p: np.ndarray, i: int, by: float) -> np.ndarray:
    moved = p.copy()
    moved[i] += by
    return moved


# ---- Numbers of an estimated model's modes that move smoothly with its derivatives

LARGEST_ROUNDED_IMAGINARY = 1e-9  # rad/s, below which an imaginary part is rounding
CONTROLS = ("elevator", "stick")


@dataclass(frozen=True, eq=False)
class Characteristics:
    """``values (k,)`` with ``covariance (k, k)`` by ``names``: ``short_period_rate`` (1/s),
    ``short_period_stiffness`` (1/s2), likewise ``phugoid``, ``dutch_roll`` and ``roll_spiral``
    (roll and spiral in one oscillation); ``roll_root``, ``spiral_root`` (1/s, growing above zero);
    ``bank_ratio`` |phi/beta| of the Dutch roll; ``load_factor_slope`` (g/rad) and ``delay`` (s) of
    a held stick."""

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray


def characteristics(
    system: System, estimate: Estimate, fixed_states: Collection[str] = ()
) -> Characteristics | None:
    """Return the characteristics of the model at an estimate of its parameters; None if it has
    none, or if the data leave a parameter open.

    Linearised in the estimated parameters. ``fixed_states``: states that do not move, as for
    ``modal_estimate``.
    """
    finite = np.all(np.isfinite(estimate.values)) and np.all(np.isfinite(estimate.covariance))
    if not finite or estimate.outcome is Outcome.NOT_IDENTIFIABLE:
        return None
    names, values, gradient = propagated(
        lambda p: _without(characteristics_at(system, p, fixed_states), estimate), system, estimate
    )
    if not names or not np.all(np.isfinite(gradient)):
        return None
    return Characteristics(names, values, gradient @ estimate.covariance @ gradient.T)


def characteristics_at(
    system: System, p: np.ndarray, fixed_states: Collection[str] = ()
) -> dict[str, float]:
    """Return the characteristics at parameters ``p`` of the System, without covariance."""
    states = {state.name for state in system.states}
    if states.issuperset(LATERAL_STATES):
        out = _lateral(system, p)
    elif states.issuperset(LONGITUDINAL_STATES):
        out = _longitudinal(system, p)
    elif states.issuperset(("alpha", "q")):
        out = _short_period(
            system, p, [name for name in system.state_names if name not in fixed_states]
        )
    else:
        return {}
    if out and "delay" in system.parameters and "stick" in system.input_names:
        out["delay"] = float(p[system.parameters.index("delay")])
    return out


def _without(values: dict[str, float], estimate: Estimate) -> dict[str, float]:
    """Return the characteristics without a delay that was not estimated."""
    return {
        name: value for name, value in values.items() if name != "delay" or name in estimate.names
    }


def _lateral(system: System, p: np.ndarray) -> dict[str, float]:
    F, _ = _slopes(
        system, [0.0] * len(system.states), [0.0] * len(system.inputs), p, LATERAL_STATES
    )
    if not np.all(np.isfinite(F)):
        return {}
    roots, vectors = np.linalg.eig(F)
    pairs = sorted(
        (i for i, root in enumerate(roots) if root.imag > LARGEST_ROUNDED_IMAGINARY),
        key=lambda i: abs(roots[i]),
    )
    if not pairs:
        return {}
    quick = pairs[-1]
    ratio = abs(vectors[LATERAL_STATES.index("phi"), quick]) / abs(
        vectors[LATERAL_STATES.index("beta"), quick]
    )
    out = {**_pair("dutch_roll", roots[quick], roots[quick].conj()), "bank_ratio": float(ratio)}
    if len(pairs) == 2:
        return {**out, **_pair("roll_spiral", roots[pairs[0]], roots[pairs[0]].conj())}
    spiral, roll = sorted(
        (root.real for root in roots if abs(root.imag) <= LARGEST_ROUNDED_IMAGINARY), key=abs
    )
    return {**out, "roll_root": float(roll), "spiral_root": float(spiral)}


def _longitudinal(system: System, p: np.ndarray) -> dict[str, float]:
    trim = level_flight(system, p)
    if trim is None:
        return {}
    F, _ = _slopes(system, *trim, p, LONGITUDINAL_STATES)
    if not np.all(np.isfinite(F)):
        return {}
    slow, quick = np.split(np.array(sorted(np.linalg.eigvals(F), key=abs)), 2)
    slope = _load_factor_slope(system, trim, p, ("alpha", "q"))
    # a pair between them belongs to neither
    split = [abs(np.sum(two).imag) > LARGEST_ROUNDED_IMAGINARY for two in (slow, quick)]
    return (
        {} if any(split) else {**_pair("short_period", *quick), **slope, **_pair("phugoid", *slow)}
    )


def _short_period(system: System, p: np.ndarray, moving: list[str]) -> dict[str, float]:
    rest = [0.0] * len(system.states), [0.0] * len(system.inputs)
    F, _ = _slopes(system, *rest, p, moving)
    if not np.all(np.isfinite(F)):  # a model of totals may have no rest
        return {}
    pairs = sorted(
        (root for root in np.linalg.eigvals(F) if root.imag > LARGEST_ROUNDED_IMAGINARY), key=abs
    )
    at = [moving.index(name) for name in ("alpha", "q")]
    roots = (pairs[0], pairs[0].conj()) if pairs else np.linalg.eigvals(F[np.ix_(at, at)])
    return {**_pair("short_period", *roots), **_load_factor_slope(system, rest, p, moving)}


def _load_factor_slope(
    system: System, about: tuple[list[float], list[float]], p: np.ndarray, moving: Collection[str]
) -> dict[str, float]:
    """n/alpha (g/rad) of a control that is held, at constant speed: V/g times the steady pitch rate
    for each radian of angle of attack.
    """
    control = next((name for name in CONTROLS if name in system.input_names), None)
    speed = next(
        (name for name in ("airspeed", "reference_airspeed") if name in system.parameters), None
    )
    if control is None or speed is None:
        return {}
    F, B = _slopes(system, *about, p, tuple(moving))
    try:
        steady = np.linalg.solve(F, -B[:, system.input_names.index(control)])
    except np.linalg.LinAlgError:
        return {}
    alpha, q = (steady[list(moving).index(name)] for name in ("alpha", "q"))
    gravity = p[system.parameters.index("gravity")] if "gravity" in system.parameters else G0
    return (
        {"load_factor_slope": float(p[system.parameters.index(speed)] / gravity * q / alpha)}
        if alpha
        else {}
    )


def _slopes(
    system: System, x: list[float], u: list[float], p: np.ndarray, names: Collection[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of the rates of ``names``: by these states, and by all inputs."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return F, complex_step_jacobian(lambda inputs: system.f(0.0, x, inputs, values), u)[at]


def _pair(name: str, one: complex, other: complex) -> dict[str, float]:
    return {
        f"{name}_rate": float(-(one + other).real),
        f"{name}_stiffness": float((one * other).real),
    }
