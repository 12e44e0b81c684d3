"""Modes of an estimated model: frequencies, damping ratios and time constants, with covariance; and
its state-space matrices.

The modes are the roots of the equations about wings-level, level flight (Etkin and Reid, Dynamics
of Flight, 3rd ed., sections 6.2 and 6.7). States that effects add are held constant, so that the
modes are those of the airframe.

A pair of roots is described by the coefficients of s^2 + rate s + stiffness, with
rate = 2 zeta omega and stiffness = omega^2. Unlike damping and frequency, they are smooth functions
of the parameters where an oscillation becomes two real roots, so that a Gaussian distribution
describes them better. Levels of flying qualities follow from random samples of these numbers
(`ident.flying_qualities.levels`).

State-space matrices. With dx = x - x0, and likewise for u and y, the linear model is
dx_dot = A dx + B du, dy = C dx + D du. The matrices follow from complex steps through the functions
f and h that the fits use, and are exact to rounding. Pure delays of inputs are not in the matrices;
`to_control` adds a Pade approximation of them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.statistics.intervals import variance_along
from sim.declaration.effect import Signal
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import G0, complex_step_jacobian

if TYPE_CHECKING:
    import control


# ---- Modes of a whole axis of motion

LATERAL_STATES = ("beta", "p", "r", "phi")
LONGITUDINAL_STATES = ("airspeed", "alpha", "theta", "q")
TRIMMED_BY = ("elevator", "thrust")  # inputs that trim level flight
TRIM_STEPS = 20  # most Newton steps towards the trim
SETTLED_SHARE = 1e-10  # largest last step, relative to the unknowns or absolute
START_ALPHA = 0.05  # rad, angle of attack at which the search for the trim begins


def lateral_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """Return the lateral modes by name: ``dutch_roll_frequency`` (rad/s), ``dutch_roll_damping``,
    ``roll_time_constant`` and ``spiral_time_constant`` (s).

    A time constant is -1/root, negative for a growing mode. Its absolute value times ln 2 is the
    time to half or to double the amplitude. If roll and spiral are one oscillation, slower than the
    Dutch roll, the time constants are left out. ``p`` has all parameters of the System.
    """
    roots = _roots(
        system, [0.0] * len(system.states), [0.0] * len(system.inputs), p, LATERAL_STATES
    )
    pairs, real = _complex_pairs(roots), _real_roots(roots)
    modes = _oscillation("dutch_roll", pairs[-1]) if pairs else {}
    if len(real) == 2 and pairs and np.all(real != 0.0):
        spiral, roll = sorted(real, key=abs)
        modes |= {
            "roll_time_constant": float(-1.0 / roll),
            "spiral_time_constant": float(-1.0 / spiral),
        }
    return modes


def longitudinal_modes(system: System, p: np.ndarray) -> dict[str, float]:
    """Return the longitudinal modes by name: ``short_period_frequency``, ``phugoid_frequency``
    (rad/s), ``short_period_damping`` and ``phugoid_damping``.

    They are those about level flight at the reference airspeed (`level_flight`); the result is
    empty if there is no such flight. A mode that does not oscillate is left out. ``p`` has all
    parameters of the System.
    """
    trim = level_flight(system, p)
    if trim is None:
        return {}
    roots = _roots(system, *trim, p, LONGITUDINAL_STATES)
    pairs, real = _complex_pairs(roots), _real_roots(roots)
    if len(pairs) == 2:
        return {**_oscillation("short_period", pairs[1]), **_oscillation("phugoid", pairs[0])}
    if len(pairs) == 1:
        slow = abs(pairs[0]) < np.max(np.abs(real))
        return _oscillation("phugoid" if slow else "short_period", pairs[0])
    return {}


def level_flight(system: System, p: np.ndarray) -> tuple[list[float], list[float]] | None:
    """Return the states and inputs of steady level flight at the parameter
    ``reference_airspeed``; None if no elevator and thrust trim the aircraft.
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
    """Return the eigenvalues of the motion of the states ``names`` alone; empty if not finite."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return np.linalg.eigvals(F) if np.all(np.isfinite(F)) else np.zeros(0)


def _complex_pairs(roots: np.ndarray) -> list[complex]:
    """Return one root of each oscillation, sorted by frequency."""
    return sorted((complex(root) for root in roots if root.imag > 1e-9), key=abs)


def _real_roots(roots: np.ndarray) -> np.ndarray:
    """Return the real ones of some roots."""
    return np.array([root.real for root in roots if abs(root.imag) <= 1e-9])


def _oscillation(name: str, root: complex) -> dict[str, float]:
    """Return frequency and damping ratio of a complex root, with names that begin with ``name``."""
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
    """Return the undamped natural frequency (rad/s) and the damping ratio of the slowest complex
    pair of roots at zero states and inputs; None if all roots are real or the derivatives are not
    finite.

    For a short-period model this is the short period, also if the model has elastic modes.
    ``fixed_states`` are names of states that are held constant because they belong to a slower
    mode, such as airspeed and attitude of the phugoid.
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
    """Return name of a number of a mode -> its value and standard deviation, in ``MODAL_UNITS``.

    A model with all states of the lateral or the longitudinal motion has the numbers of
    `lateral_modes` or `longitudinal_modes`. Any other model has ``natural_frequency`` and
    ``damping_ratio`` of the short period (`slowest_oscillation`, with the same ``fixed_states``).
    Standard deviations follow by linearisation in the estimated parameters, as in NASA TM-101722,
    figure 8. Numbers on which no estimated parameter has an effect are left out.
    """
    names, centre, gradient = propagated(_modes_function(system, fixed_states), system, estimate)
    std = np.sqrt(variance_along(estimate.covariance, gradient))
    return {
        name: (float(value), float(sigma))
        for name, value, sigma in zip(names, centre, std, strict=True)
        if sigma > 0.0
    }


def propagated(
    numbers: Callable[[np.ndarray], Mapping[str, float]], system: System, estimate: Estimate
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return the names and values ``(k,)`` of numbers that are functions of the parameters, at an
    estimate, and their derivatives ``(k, n)`` with respect to the n estimated parameters.

    ``numbers`` returns name -> value for given values of all parameters. The derivatives are
    central differences over a ten-thousandth of a sigma, or of the value where the sigma is larger.
    A number that does not exist on both sides is left out.
    """
    p = system.parameters.values()
    index = [system.parameters.index(name) for name in estimate.names]
    p[index] = estimate.values
    centre = numbers(p)
    gradient = {name: np.zeros(len(index)) for name in centre}
    for column, (i, sigma) in enumerate(zip(index, estimate.std, strict=True)):
        size = min(sigma, abs(p[i])) if p[i] else min(sigma, 1.0)
        step = max(1e-4 * size, 1e-9 * abs(p[i]), 1e-300)
        above, below = (numbers(_with_change(p, i, by)) for by in (step, -step))
        gradient = {name: row for name, row in gradient.items() if name in above and name in below}
        for name, row in gradient.items():
            row[column] = (above[name] - below[name]) / (2.0 * step)
    return (
        tuple(gradient),
        np.array([centre[name] for name in gradient]),
        np.array([*gradient.values()]).reshape(len(gradient), len(index)),
    )


def _modes_function(
    system: System, fixed_states: Collection[str]
) -> Callable[[np.ndarray], dict[str, float]]:
    """Return the function that returns the modes of the System for values of all parameters."""
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


def _with_change(p: np.ndarray, i: int, change: float) -> np.ndarray:
    """Return the parameters with ``change`` added to parameter ``i``."""
    changed = p.copy()
    changed[i] += change
    return changed


# ---- Characteristics of modes that are smooth functions of the derivatives

LARGEST_ROUNDED_IMAGINARY = 1e-9  # rad/s: a smaller imaginary part is rounding
CONTROLS = ("elevator", "stick")  # pitch controls, the preferred one first


@dataclass(frozen=True, eq=False)
class Characteristics:
    """Characteristics of the modes of a model.

    The names are ``short_period_rate`` (1/s) and ``short_period_stiffness`` (1/s2), the same for
    ``phugoid``, ``dutch_roll`` and ``roll_spiral`` (roll and spiral as one oscillation);
    ``roll_root`` and ``spiral_root`` (1/s, positive for growth); ``bank_ratio``, |phi/beta| of the
    Dutch roll; ``load_factor_slope`` (g/rad), n/alpha at a constant control; and ``delay`` (s) of
    the stick.

    Attributes
    ----------
    names : names of the k characteristics.
    values : ``(k,)``.
    covariance : ``(k, k)``.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray


def characteristics(
    system: System, estimate: Estimate, fixed_states: Collection[str] = ()
) -> Characteristics | None:
    """Return the characteristics of a model at an estimate of its parameters; None if it has none,
    or if the data do not determine a parameter.

    The covariance follows by linearisation in the estimated parameters. ``fixed_states`` are those
    of `slowest_oscillation`.
    """
    finite = np.all(np.isfinite(estimate.values)) and np.all(np.isfinite(estimate.covariance))
    if not finite or estimate.outcome is Outcome.NOT_IDENTIFIABLE:
        return None
    names, values, gradient = propagated(
        lambda p: _without_declared_delay(characteristics_at(system, p, fixed_states), estimate),
        system,
        estimate,
    )
    if not names or not np.all(np.isfinite(gradient)):
        return None
    return Characteristics(names, values, gradient @ estimate.covariance @ gradient.T)


def characteristics_at(
    system: System, p: np.ndarray, fixed_states: Collection[str] = ()
) -> dict[str, float]:
    """Return characteristic -> value at parameters ``p`` of the System."""
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


def _without_declared_delay(values: dict[str, float], estimate: Estimate) -> dict[str, float]:
    """Return the characteristics without a delay that was not estimated."""
    return {
        name: value for name, value in values.items() if name != "delay" or name in estimate.names
    }


def _lateral(system: System, p: np.ndarray) -> dict[str, float]:
    """Return the characteristics of the lateral motion."""
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
    fast = pairs[-1]
    ratio = abs(vectors[LATERAL_STATES.index("phi"), fast]) / abs(
        vectors[LATERAL_STATES.index("beta"), fast]
    )
    out = {**_pair("dutch_roll", roots[fast], roots[fast].conj()), "bank_ratio": float(ratio)}
    if len(pairs) == 2:
        return {**out, **_pair("roll_spiral", roots[pairs[0]], roots[pairs[0]].conj())}
    spiral, roll = sorted(
        (root.real for root in roots if abs(root.imag) <= LARGEST_ROUNDED_IMAGINARY), key=abs
    )
    return {**out, "roll_root": float(roll), "spiral_root": float(spiral)}


def _longitudinal(system: System, p: np.ndarray) -> dict[str, float]:
    """Return the characteristics of the longitudinal motion about level flight."""
    trim = level_flight(system, p)
    if trim is None:
        return {}
    F, _ = _slopes(system, *trim, p, LONGITUDINAL_STATES)
    if not np.all(np.isfinite(F)):
        return {}
    slow, fast = np.split(np.array(sorted(np.linalg.eigvals(F), key=abs)), 2)
    slope = _load_factor_slope(system, trim, p, ("alpha", "q"))
    # A complex pair whose roots are split between the two motions belongs to neither.
    split = [abs(np.sum(two).imag) > LARGEST_ROUNDED_IMAGINARY for two in (slow, fast)]
    return (
        {} if any(split) else {**_pair("short_period", *fast), **slope, **_pair("phugoid", *slow)}
    )


def _short_period(system: System, p: np.ndarray, moving: list[str]) -> dict[str, float]:
    """Return the characteristics of the short period, with the states ``moving``."""
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
    """Return ``load_factor_slope``, n/alpha (g/rad) at constant control and speed: V/g times the
    steady pitch rate per radian of angle of attack; empty if it does not exist.

    ``about`` has the states and inputs of the trim, and ``moving`` the names of the states that are
    not held constant.
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
    """Return the derivatives of the rates of states ``names`` by these and by all inputs."""
    values, at = p.tolist(), [system.state_names.index(name) for name in names]
    F = complex_step_jacobian(lambda state: system.f(0.0, state, u, values), x)[np.ix_(at, at)]
    return F, complex_step_jacobian(lambda inputs: system.f(0.0, x, inputs, values), u)[at]


def _pair(name: str, one: complex, other: complex) -> dict[str, float]:
    """Return rate and stiffness of a pair of roots, with names that begin with ``name``."""
    return {
        f"{name}_rate": float(-(one + other).real),
        f"{name}_stiffness": float((one * other).real),
    }


# ---- State-space matrices of a model, linearised about a point


# order of the approximation of a delay: within two degrees of phase up to omega delay = 5
PADE_ORDER = 4
DELAY = "delay"  # parameter of a low-order equivalent system
DELAY_STAGE = "input-delay"  # effect that the delay belongs to


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear model about a point.

    Attributes
    ----------
    A, B, C, D : matrices ``(n, n)``, ``(n, m)``, ``(k, n)``, ``(k, m)``.
    states, inputs, outputs : names and units of the n, m and k signals.
    x0, u0, y0 : states, inputs and outputs at the point.
    rates : ``(n,)`` rates of the states at the point, zero in equilibrium.
    delays : name of an input -> its pure delay, s.
    left_out : names of effects with states of their own on the input or sensor path, which the
        matrices do not include.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    x0: np.ndarray
    u0: np.ndarray
    y0: np.ndarray
    rates: np.ndarray
    delays: Mapping[str, float]
    left_out: tuple[str, ...] = ()

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of A (1/s), sorted by magnitude."""
        return np.array(sorted(np.linalg.eigvals(self.A), key=lambda root: (abs(root), root.imag)))


def state_space(
    system: System,
    values: Mapping[str, float],
    x0: Sequence[float] | None = None,
    u0: Sequence[float] | None = None,
) -> StateSpace:
    """Return a System linearised about states ``x0`` and inputs ``u0``; None takes zeros.

    ``values`` maps parameters to values; other parameters have their declared values. Raises
    ModelError if the rates or their derivatives are not finite at the point.
    """
    known = {name: value for name, value in values.items() if name in system.parameters}
    p = system.parameters.with_values(known).values().tolist()
    x = [0.0] * len(system.states) if x0 is None else [float(value) for value in x0]
    u = [0.0] * len(system.inputs) if u0 is None else [float(value) for value in u0]
    try:
        with np.errstate(all="ignore"):
            (A, B, rates), (C, D, y0) = (_linear(g, x, u, p) for g in (system.f, system.h))
            finite = all(np.all(np.isfinite(some)) for some in (A, B, C, D, rates, y0))
    except ArithmeticError:
        finite = False
    if not finite:
        point = ", ".join(
            f"{name} {value:g}" for name, value in zip(system.state_names, x, strict=True)
        )
        raise ModelError(
            f"no finite derivatives at {point}", where="state_space", remedy="choose another point"
        )
    delays = (
        {"stick": p[system.parameters.index(DELAY)]}
        if DELAY in system.parameters and "stick" in system.input_names
        else {}
    )
    stages = tuple(
        name
        for name in (*system.input_stages, *system.sensor_stages)
        if not (delays and name == DELAY_STAGE)
    )
    return StateSpace(
        A,
        B,
        C,
        D,
        system.states,
        system.inputs,
        system.outputs,
        np.array(x),
        np.array(u),
        y0,
        rates,
        delays,
        stages,
    )


def _linear(
    g: Callable[..., Any], x: list[float], u: list[float], p: list[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of f or h with respect to states and to inputs, and the value."""
    value = np.array(g(0.0, x, u, p), dtype=float)
    by_inputs = (
        complex_step_jacobian(lambda a: g(0.0, x, a, p), u) if u else np.zeros((len(value), 0))
    )
    return complex_step_jacobian(lambda a: g(0.0, a, u, p), x), by_inputs, value


def to_control(space: StateSpace, pade: int = PADE_ORDER) -> control.StateSpace:
    """Return the model as a StateSpace of python-control, with the names of its signals.

    Each delay is replaced by a Pade approximation of order ``pade``; order 0 leaves delays out. The
    states of an approximation follow those of the model and are named after the input. Raises
    ModelError for a model without inputs.
    """
    import control

    if not space.inputs:
        raise ModelError(
            "a model without an input cannot be converted for python-control",
            where="to_control",
            remedy="use its matrices A and C",
        )
    A, B, C, D = space.A, space.B, space.C, space.D
    names = [signal.name for signal in space.states]
    for i, signal in enumerate(space.inputs):
        delay = space.delays.get(signal.name, 0.0)
        if pade < 1 or not delay > 0.0:
            continue
        delay_system = control.tf2ss(*control.pade(delay, pade))
        order, old = delay_system.nstates, len(A)
        column, through = B[:, i : i + 1].copy(), D[:, i : i + 1].copy()
        A = np.block([[A, column @ delay_system.C], [np.zeros((order, old)), delay_system.A]])
        B = np.vstack([B, np.zeros((order, B.shape[1]))])
        B[:, i : i + 1] = np.vstack([column @ delay_system.D, delay_system.B])
        C, D = np.hstack([C, through @ delay_system.C]), D.copy()
        D[:, i : i + 1] = through @ delay_system.D
        names += [f"{signal.name}_delay_{k + 1}" for k in range(order)]
    inputs, outputs = ([signal.name for signal in row] for row in (space.inputs, space.outputs))
    return control.ss(A, B, C, D, states=names, inputs=inputs, outputs=outputs)
