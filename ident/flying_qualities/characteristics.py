"""Numbers of an estimated model's modes that move smoothly with its derivatives, with their covariance.

A pair of roots is told by the coefficients of s^2 + rate s + stiffness, rate = 2 zeta omega and stiffness = omega^2: they stay smooth where an
oscillation becomes two real roots, and a Gaussian of them is no Gaussian of damping and frequency. Levels of flying qualities are read from draws of
these numbers (``mode_levels``).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.modal import propagated
from ident.flying_qualities.whole_axes import LATERAL_STATES, LONGITUDINAL_STATES, level_flight
from sim.declaration.model import System
from sim.maths import G0, complex_step_jacobian

REAL = 1e-9  # rad/s, below which an imaginary part is rounding
CONTROLS = ("elevator", "stick")


@dataclass(frozen=True, eq=False)
class Characteristics:
    """``values (k,)`` with ``covariance (k, k)`` by ``names``: ``short_period_rate`` (1/s), ``short_period_stiffness`` (1/s2), likewise
    ``phugoid``, ``dutch_roll`` and ``roll_spiral`` (roll and spiral in one oscillation); ``roll_root``, ``spiral_root`` (1/s, growing above zero);
    ``bank_ratio`` |phi/beta| of the Dutch roll; ``load_factor_slope`` (g/rad) and ``delay`` (s) of a held stick."""

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray


def characteristics(system: System, estimate: Estimate, held: Collection[str] = ()) -> Characteristics | None:
    """Those that the model has, at an estimate of its parameters; None where it has none, or where the data leave a parameter open.

    Linearised in the estimated parameters. ``held``: states that do not move, as for ``modal_estimate``.
    """
    known = np.all(np.isfinite(estimate.values)) and np.all(np.isfinite(estimate.covariance))
    if not known or estimate.outcome is Outcome.NOT_IDENTIFIABLE:
        return None
    names, values, gradient = propagated(lambda p: _without(characteristics_at(system, p, held), estimate), system, estimate)
    if not names or not np.all(np.isfinite(gradient)):
        return None
    return Characteristics(names, values, gradient @ estimate.covariance @ gradient.T)


def characteristics_at(system: System, p: np.ndarray, held: Collection[str] = ()) -> dict[str, float]:
    """The same numbers for all parameters ``p`` of the System, without their covariance."""
    states = {state.name for state in system.states}
    if states.issuperset(LATERAL_STATES):
        out = _lateral(system, p)
    elif states.issuperset(LONGITUDINAL_STATES):
        out = _longitudinal(system, p)
    elif states.issuperset(("alpha", "q")):
        out = _short_period(system, p, [name for name in system.state_names if name not in held])
    else:
        return {}
    if out and "delay" in system.parameters and "stick" in system.input_names:
        out["delay"] = float(p[system.parameters.index("delay")])
    return out


def _without(found: dict[str, float], estimate: Estimate) -> dict[str, float]:
    """Less a delay that was not estimated: what a file starts from is no knowledge of it."""
    return {name: value for name, value in found.items() if name != "delay" or name in estimate.names}


def _lateral(system: System, p: np.ndarray) -> dict[str, float]:
    F, _ = _slopes(system, [0.0] * len(system.states), [0.0] * len(system.inputs), p, LATERAL_STATES)
    if not np.all(np.isfinite(F)):
        return {}
    roots, vectors = np.linalg.eig(F)
    pairs = sorted((i for i, root in enumerate(roots) if root.imag > REAL), key=lambda i: abs(roots[i]))
    if not pairs:
        return {}
    quick = pairs[-1]
    ratio = abs(vectors[LATERAL_STATES.index("phi"), quick]) / abs(vectors[LATERAL_STATES.index("beta"), quick])
    out = {**_pair("dutch_roll", roots[quick], roots[quick].conj()), "bank_ratio": float(ratio)}
    if len(pairs) == 2:
        return {**out, **_pair("roll_spiral", roots[pairs[0]], roots[pairs[0]].conj())}
    spiral, roll = sorted((root.real for root in roots if abs(root.imag) <= REAL), key=abs)
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
    split = [abs(np.sum(two).imag) > REAL for two in (slow, quick)]  # a pair between them belongs to neither
    return {} if any(split) else {**_pair("short_period", *quick), **slope, **_pair("phugoid", *slow)}


def _short_period(system: System, p: np.ndarray, moving: list[str]) -> dict[str, float]:
    rest = [0.0] * len(system.states), [0.0] * len(system.inputs)
    F, _ = _slopes(system, *rest, p, moving)
    if not np.all(np.isfinite(F)):  # a model of totals may have no rest
        return {}
    pairs = sorted((root for root in np.linalg.eigvals(F) if root.imag > REAL), key=abs)
    at = [moving.index(name) for name in ("alpha", "q")]
    roots = (pairs[0], pairs[0].conj()) if pairs else np.linalg.eigvals(F[np.ix_(at, at)])
    return {**_pair("short_period", *roots), **_load_factor_slope(system, rest, p, moving)}


def _load_factor_slope(system: System, about: tuple[list[float], list[float]], p: np.ndarray, moving: Collection[str]) -> dict[str, float]:
    """n/alpha (g/rad) of a control that is held, at constant speed: V/g times the steady pitch rate for each radian of angle of attack."""
    control = next((name for name in CONTROLS if name in system.input_names), None)
    speed = next((name for name in ("airspeed", "reference_airspeed") if name in system.parameters), None)
    if control is None or speed is None:
        return {}
    F, B = _slopes(system, *about, p, tuple(moving))
    try:
        steady = np.linalg.solve(F, -B[:, system.input_names.index(control)])
    except np.linalg.LinAlgError:
        return {}
    alpha, q = (steady[list(moving).index(name)] for name in ("alpha", "q"))
    gravity = p[system.parameters.index("gravity")] if "gravity" in system.parameters else G0
    return {"load_factor_slope": float(p[system.parameters.index(speed)] / gravity * q / alpha)} if alpha else {}


def _slopes(system: System, x: list[float], u: list[float], p: np.ndarray, names: Collection[str]) -> tuple[np.ndarray, np.ndarray]:
    """Of the rates of ``names``: by these states, and by all inputs."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return F, complex_step_jacobian(lambda inputs: system.f(0.0, x, inputs, values), u)[at]


def _pair(name: str, one: complex, other: complex) -> dict[str, float]:
    return {f"{name}_rate": float(-(one + other).real), f"{name}_stiffness": float((one * other).real)}
