"""Equation error in the frequency domain on recursive Fourier transforms, for streams.

Morelli, "Real-Time Parameter Estimation in the Frequency Domain", Journal of Guidance, Control, and
Dynamics 23(5), 2000; Klein and Morelli, "Aircraft System Identification", AIAA 2006, chapter 11.

The integrated equation of motion from sample i to i + 1 is x_{i+1} - x_i = integral of f(x, u) dt.
Both sides, times exp(-j omega t_i), are summed as the samples arrive, so that no sample is stored
and no extra term is needed for the beginning and the end of the motion. For equations that are
linear in their parameters, f = f_0 + sum_j theta_j f_j, this is a regression at each frequency. A
constant in each equation represents biases and errors of the trim. Unlike in Morelli's method, the
integrals are computed by Simpson's rule with Hermite interpolation, to fourth order for inputs that
are held or linear between samples. The regression is in `ident.frequency_domain.online_regression`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.estimate import LARGEST_NUMBER
from ident.frequency_domain.transform import NONLINEARITY_TOLERANCE
from ident.statistics.noise_levels import SIGMA_PER_MEDIAN_DEVIATION
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP, complex_step_jacobian
from sim.record import Hold

LOWEST_FREQUENCY = 0.1  # Hz, as Morelli's: above slow drifts
HIGHEST_FREQUENCY = 2.0  # Hz, as Morelli's: below structural modes
FREQUENCY_SPACING = 0.04  # Hz
_THIRD_DIFFERENCE_VARIANCE = 20.0  # variance of a third difference of unit white noise


@dataclass(frozen=True, eq=False)
class OnlineEquations:
    """The equations of a System that are regressed.

    Attributes
    ----------
    system : the model.
    names : names of the q free parameters.
    positions : positions of these parameters among all parameters of the System.
    states : positions of the states whose equations are used.
    readings : positions of the outputs that are not states.
    sources : for each state, the position of the output that measures it; -1 if the caller computes
        the state.
    omega : ``(F,)`` evenly spaced frequencies, rad/s.
    states_from_outputs : ``(n, n)`` matrix that computes states from the outputs with their names,
        since a vane ahead of the centre of gravity also measures the pitch rate.
    hold : behaviour of the inputs between rows.
    """

    system: System
    names: tuple[str, ...]
    positions: tuple[int, ...]
    states: tuple[int, ...]
    readings: tuple[int, ...]
    sources: tuple[int, ...]
    omega: np.ndarray
    states_from_outputs: np.ndarray
    hold: Hold = Hold.PREVIOUS

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the equations, states first."""
        rates = [self.system.state_names[k] for k in self.states]
        return (*rates, *(self.system.output_names[k] for k in self.readings))


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over the rows of a stream so far, for e equations and F frequencies.

    A regressor is the derivative of the right-hand side with respect to a parameter. The known side
    is the left-hand side minus the terms without free parameters.

    Attributes
    ----------
    rows : number of rows used.
    time : time of the last row, s.
    x, u : states ``(n,)`` and inputs ``(r,)`` of the last row; None before the first row.
    known_side : ``(e, F)`` transforms of the known sides.
    regressors : ``(e, q, F)`` transforms of the regressors.
    constant : ``(e, F)`` transforms of a constant one.
    at_differences, at_sums : ``(F,)`` and ``(2F - 1,)``, sums of exp(-j omega t) over the rows,
        with omega the differences and the sums of two frequencies.
    squared_slopes : ``(e, n, q + 1, q + 1)`` sums of products of the derivatives of the regressors
        and, last, of the known side with respect to each state.
    noise : ``(n + m,)`` for each state, and for each output that is not a state, the sum of
        estimates of the noise standard deviation, each weighted by its number of samples.
    noise_counts : ``(n + m,)`` sums of these numbers.
    recent : ``(n + m, 3)`` the last samples of these signals.
    first : time of the first row, s.
    """

    rows: int
    time: float
    x: np.ndarray | None
    u: np.ndarray | None
    known_side: np.ndarray
    regressors: np.ndarray
    constant: np.ndarray
    at_differences: np.ndarray
    at_sums: np.ndarray
    squared_slopes: np.ndarray
    noise: np.ndarray
    noise_counts: np.ndarray
    recent: np.ndarray
    first: float = 0.0

    def with_copied_transforms(self) -> Sums:
        """Return the sums with copies of the transforms, which may be changed in place."""
        names = ("known_side", "regressors", "constant")
        return replace(self, **{name: getattr(self, name).copy() for name in names})

    @property
    def noise_variance(self) -> np.ndarray:
        """Variance of the noise of a sample of each state and reading, ``(n + m,)``."""
        return np.asarray((self.noise / np.maximum(self.noise_counts, 1.0)) ** 2)


def frequencies(
    low: float = LOWEST_FREQUENCY,
    high: float = HIGHEST_FREQUENCY,
    spacing: float = FREQUENCY_SPACING,
) -> np.ndarray:
    """Return evenly spaced frequencies, rad/s, from ``low`` to ``high``, Hz, about ``spacing``, Hz,
    apart.
    """
    count = max(round((high - low) / spacing), 3)
    return 2.0 * math.pi * np.linspace(low, high, count + 1)


def online_equations(
    system: System, omega: np.ndarray, measured: Sequence[str], computed: Sequence[str] = ()
) -> OnlineEquations:
    """Return the equations of a System for a stream.

    Parameters
    ----------
    omega : ``(F,)`` evenly spaced frequencies, rad/s.
    measured : names of the outputs in the stream.
    computed : names of states that the caller computes from the inputs; their equations are left
        out.

    Raises
    ------
    ModelError : if a state is not measured, an effect has a memory, or no parameter is free.
    """
    where = "equation error on line"
    for stage in (*(() if computed else system.input_stages), *system.sensor_stages):
        raise ModelError(
            f"effect {stage} keeps a memory",
            where=where,
            remedy="leave it out, or use flightid identify",
        )
    names = tuple(name for name in system.parameters.free_names if not name.startswith("bias_"))
    if not names:
        raise ModelError("no parameter is free", where=where, remedy="release at least one")
    outputs = system.output_names
    sources = []
    for state in system.state_names:
        if state in computed:
            sources.append(-1)
        elif state in outputs and state in measured:
            sources.append(outputs.index(state))
        else:
            remedy = f"stream a channel {state}, or use flightid identify"
            raise ModelError(f"state {state} is not measured", where=where, remedy=remedy)
    states = tuple(k for k, source in enumerate(sources) if source >= 0)
    readings = tuple(
        k for k, name in enumerate(outputs) if name not in system.state_names and name in measured
    )
    positions = tuple(system.parameters.index(name) for name in names)
    states_from_outputs = _states_from_outputs(system, positions, sources)
    return OnlineEquations(
        system, names, positions, states, readings, tuple(sources), omega, states_from_outputs
    )


def _states_from_outputs(
    system: System, positions: Sequence[int], sources: Sequence[int]
) -> np.ndarray:
    """Return the matrix ``(n, n)`` that computes states from the outputs with their names.

    Raises ModelError if a free parameter acts on these outputs.
    """
    n, rest = len(sources), [0.0] * len(system.inputs)
    known = [k for k, source in enumerate(sources) if source >= 0]

    def reading(p: list[float]) -> np.ndarray:
        start = [item.value for item in system.initial]
        return complex_step_jacobian(lambda x: system.h(0.0, x, rest, p), start)

    p = system.parameters.values().tolist()
    base = reading(p)[[sources[k] for k in known]]
    for position in positions:
        moved = list(p)
        moved[position] += 0.1 * max(abs(p[position]), 1e-3)
        if not np.allclose(reading(moved)[[sources[k] for k in known]], base, rtol=0.0, atol=1e-12):
            name = system.parameters.names[position]
            remedy = f"fix {name}, or use flightid identify"
            raise ModelError(
                f"{name} acts on the reading of a state",
                where="equation error on line",
                remedy=remedy,
            )
    out = np.zeros((n, n))
    out[np.ix_(known, known)] = np.linalg.inv(base[:, known])
    return out


def empty_sums(equations: OnlineEquations) -> Sums:
    """Return the sums of a stream without rows."""
    e, q = len(equations.states) + len(equations.readings), len(equations.names)
    n, f = len(equations.system.states), equations.omega.size
    signal_count = n + len(equations.readings)
    zero = np.zeros((e, f), dtype=complex)
    wide = np.zeros((e, q, f), dtype=complex)
    squared_slopes, blank = np.zeros((e, n, q + 1, q + 1)), np.full((signal_count, 3), np.nan)
    differences, at_sums = np.zeros(f, dtype=complex), np.zeros(2 * f - 1, dtype=complex)
    return Sums(
        0,
        -math.inf,
        None,
        None,
        zero,
        wide,
        zero,
        differences,
        at_sums,
        squared_slopes,
        np.zeros(signal_count),
        np.zeros(signal_count),
        blank,
    )


def advance(
    equations: OnlineEquations,
    sums: Sums,
    time: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    values: np.ndarray | None = None,
    computed: np.ndarray | None = None,
) -> Sums:
    """Return the sums after further rows.

    Parameters
    ----------
    time : ``(N,)`` increasing times, s.
    inputs : ``(r, N)``, held or linear between rows according to ``equations.hold``.
    outputs : ``(m, N)`` in the order of the System, NaN where a sample is missing. A row in which a
        state is missing is skipped: the step then leads to the next complete row.
    values : ``(q,)`` last estimate of the parameters, for the states at the middle of a step; None
        takes the values of the System.
    computed : ``(n, N)`` states that the caller computes; the rows of other states are not used.
    """
    n = len(equations.system.states)
    rows = [outputs[source] if source >= 0 else np.zeros(time.size) for source in equations.sources]
    x = equations.states_from_outputs @ np.array(rows)
    if computed is not None:
        for k, source in enumerate(equations.sources):
            x[k] = computed[k] if source < 0 else x[k]
    complete = np.all(np.isfinite(x), axis=0)
    if not complete.any():
        return sums
    linear = equations.hold is Hold.LINEAR
    mean = _means_between(time, inputs, complete, linear=linear)
    has_rows = sums.x is not None and sums.u is not None
    times = np.concatenate([[sums.time] if has_rows else [], time[complete]])
    states = np.concatenate(
        [sums.x[:, None] if sums.x is not None else np.zeros((n, 0)), x[:, complete]], axis=1
    )
    before = sums.u[:, None] if sums.u is not None else np.zeros((len(inputs), 0))
    u = np.concatenate([before, inputs[:, complete] if linear else mean], axis=1)
    step_inputs = np.repeat(u[None, :, :-1], 3, axis=0)
    if linear and times.size > 1:
        # The middle value is such that Simpson's rule gives the mean input over skipped rows.
        means = np.concatenate([0.5 * (before + u[:, 1:2]) if has_rows else before, mean], axis=1)
        middle = 1.5 * means[:, : times.size - 1] - 0.25 * (u[:, :-1] + u[:, 1:])
        step_inputs = np.array([u[:, :-1], middle, u[:, 1:]])
    points = LinearParts(equations, values)
    out = _with_steps(equations, sums, points, times, states, step_inputs)
    at_rows = (rows[:, complete] for rows in (x, inputs, outputs))
    out = _with_readings(equations, out, points, time[complete], *at_rows)
    new_samples = np.concatenate([x, outputs[list(equations.readings)]])[:, complete]
    out = _with_noise(equations, out, points, times, states, u, new_samples)
    kept = np.concatenate([sums.recent, new_samples], axis=1)[:, -3:]
    return replace(
        out,
        rows=out.rows + int(complete.sum()),
        time=float(times[-1]),
        x=states[:, -1],
        u=u[:, -1],
        recent=kept,
        first=sums.first if has_rows else float(times[0]),
    )


def _means_between(
    time: np.ndarray, inputs: np.ndarray, complete: np.ndarray, *, linear: bool
) -> np.ndarray:
    """Return the mean inputs ``(r, K)`` between successive ones of the K complete rows, skipped
    rows included. The last column has the inputs of the last complete row.
    """
    at = np.flatnonzero(complete)
    steps = 0.5 * (inputs[:, :-1] + inputs[:, 1:]) if linear else inputs[:, :-1]
    gained = np.cumsum(steps * np.diff(time), axis=1)
    whole = np.concatenate([np.zeros((len(inputs), 1)), gained], axis=1)
    spans = np.diff(time[at])
    between = np.diff(whole[:, at], axis=1) / spans
    return np.concatenate([between, inputs[:, at[-1:]]], axis=1)


@dataclass(frozen=True, eq=False)
class LinearParts:
    """Rates and outputs of a System, split into terms without and with free parameters.

    ``values (q,)`` is the last estimate of the parameters; None takes the values of the System.
    """

    equations: OnlineEquations
    values: np.ndarray | None

    def split(
        self, function: Any, time: np.ndarray, x: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the terms ``(rows, N)`` of ``function``, f or h of the System, without free
        parameters, and its derivatives ``(rows, q, N)`` with respect to these parameters.
        """
        system, q = self.equations.system, len(self.equations.names)
        p: list[Any] = list(system.parameters.values())
        start = np.array([p[position] for position in self.equations.positions])
        for column, position in enumerate(self.equations.positions):
            p[position] = p[position] + 1j * COMPLEX_STEP * (np.arange(q) == column)
        rows = function(time[:, None], [row[:, None] for row in x], [row[:, None] for row in u], p)
        full = np.array([np.broadcast_to(row, (time.size, q)) for row in rows])
        slopes = (full.imag / COMPLEX_STEP).transpose(0, 2, 1)
        return full.real[:, :, 0] - np.einsum("kqn,q->kn", slopes, start), slopes

    def rate(self, time: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the rates ``(n, N)`` of the states at the last estimate."""
        system = self.equations.system
        p = list(system.parameters.values())
        for k, position in enumerate(self.equations.positions):
            if self.values is not None and np.isfinite(self.values[k]):
                p[position] = float(self.values[k])
        rows = system.f(time, list(x), list(u), p)
        return np.array([np.broadcast_to(row, time.shape) for row in rows], dtype=float)


def _with_steps(
    equations: OnlineEquations,
    sums: Sums,
    points: LinearParts,
    times: np.ndarray,
    states: np.ndarray,
    step_inputs: np.ndarray,
) -> Sums:
    """Return the sums with the increments of the states between N rows, and with the integrals of
    their rates.

    ``step_inputs (3, r, N - 1)`` are the inputs at the begin, the middle and the end of each step.
    """
    if times.size < 2:
        return sums
    step = np.diff(times)
    first, last = states[:, :-1], states[:, 1:]
    rate_at_begin = points.rate(times[:-1], first, step_inputs[0])
    rate_at_end = points.rate(times[1:], last, step_inputs[2])
    middle = 0.5 * (first + last) + 0.125 * step * (rate_at_begin - rate_at_end)
    f = equations.system.f
    parts = [
        points.split(f, t, x, u)
        for t, x, u in zip(
            (times[:-1], times[:-1] + 0.5 * step, times[1:]),
            (first, middle, last),
            step_inputs,
            strict=True,
        )
    ]
    known, slopes = (
        sum(w * part[k] for w, part in zip((1.0, 4.0, 1.0), parts, strict=True)) * step / 6.0
        for k in (0, 1)
    )
    if not (np.all(np.abs(known) < LARGEST_NUMBER) and np.all(np.abs(slopes) < LARGEST_NUMBER)):
        what = "a rate is not finite at the measured states"
        raise ModelError(
            what, where="equation error on line", remedy="check units and start values"
        )
    if not np.any(sums.at_differences):
        _refuse_nonlinear(equations, times[:-1], first, step_inputs[0])
    rows = list(equations.states)
    phasors = np.exp(-1j * np.outer(times[:-1], equations.omega))
    spacing = equations.omega[1] - equations.omega[0]
    f_count = equations.omega.size
    e = len(rows)
    out = sums.with_copied_transforms()
    out.known_side[:e] += (last - first - known)[rows] @ phasors
    out.regressors[:e] += slopes[rows] @ phasors
    out.constant[:e] += step @ phasors
    near = np.exp(-1j * np.outer(times[:-1], spacing * np.arange(f_count))).sum(axis=0)
    far = np.exp(
        -1j * np.outer(times[:-1], 2.0 * equations.omega[0] + spacing * np.arange(2 * f_count - 1))
    ).sum(axis=0)
    return replace(out, at_differences=sums.at_differences + near, at_sums=sums.at_sums + far)


def _with_readings(
    equations: OnlineEquations,
    sums: Sums,
    points: LinearParts,
    time: np.ndarray,
    x: np.ndarray,
    u: np.ndarray,
    outputs: np.ndarray,
) -> Sums:
    """Return the sums with further samples of the outputs that are not states."""
    if not equations.readings:
        return sums
    known, slopes = points.split(equations.system.h, time, x, u)
    phasors = np.exp(-1j * np.outer(time, equations.omega))
    out = sums.with_copied_transforms()
    for row, k in enumerate(equations.readings, start=len(equations.states)):
        complete = np.isfinite(outputs[k])
        out.known_side[row] += (outputs[k] - known[k])[complete] @ phasors[complete]
        out.regressors[row] += slopes[k][:, complete] @ phasors[complete]
        out.constant[row] += phasors[complete].sum(axis=0)
    return out


def _with_noise(
    equations: OnlineEquations,
    sums: Sums,
    points: LinearParts,
    times: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    new_samples: np.ndarray,
) -> Sums:
    """Return the sums with the noise of ``new_samples (n + m, N)``, estimated from their third
    differences, and with the derivatives of the regressors and known sides with respect to states.
    """
    rows = np.concatenate([sums.recent, new_samples], axis=1)
    third = np.diff(rows, 3, axis=1)
    noise, noise_counts = sums.noise.copy(), sums.noise_counts.copy()
    for k, row in enumerate(third):
        finite = row[np.isfinite(row)]
        if finite.size and (k >= len(equations.sources) or equations.sources[k] >= 0):
            deviation = float(np.median(np.abs(finite)))
            size = finite.size * SIGMA_PER_MEDIAN_DEVIATION
            noise[k] += size * deviation / math.sqrt(_THIRD_DIFFERENCE_VARIANCE)
            noise_counts[k] += finite.size
    system, n = equations.system, len(equations.system.states)
    at, x, u = times[-1:], states[:, -1:], inputs[:, -1:]
    squared_slopes = sums.squared_slopes.copy()
    step = float(np.median(np.diff(times))) if times.size > 1 else 0.0

    def slopes_and_known(function: Any, x: np.ndarray) -> np.ndarray:
        known, slopes = points.split(function, at, x, u)
        return np.asarray(np.concatenate([slopes, known[:, None]], axis=1))

    f, h = slopes_and_known(system.f, x), slopes_and_known(system.h, x)
    for s in range(n):
        moved = x.copy()
        size = 1e-3 * max(abs(float(x[s, 0])), 1e-3)
        moved[s] += size
        for function, base, which, first, weight in (
            (system.f, f, equations.states, 0, step**2),
            (system.h, h, equations.readings, len(equations.states), 1.0),
        ):
            slope = (slopes_and_known(function, moved) - base)[:, :, 0] / size
            for row, k in enumerate(which, start=first):
                squared_slopes[row, s] += (
                    new_samples.shape[1] * weight * np.outer(slope[k], slope[k])
                )
    return replace(sums, squared_slopes=squared_slopes, noise=noise, noise_counts=noise_counts)


def _refuse_nonlinear(
    equations: OnlineEquations, times: np.ndarray, x: np.ndarray, u: np.ndarray
) -> None:
    """Raise ModelError if a rate or output is not linear in a free parameter."""
    system, few = equations.system, slice(0, 8)
    p = list(system.parameters.values())

    def evaluated(values: list[float]) -> np.ndarray:
        given = (times[few], list(x[:, few]), list(u[:, few]), values)
        rows = (*system.f(*given), *system.h(*given))
        return np.array([np.broadcast_to(row, times[few].shape) for row in rows], dtype=float)

    base = evaluated(p)
    for name, position in zip(equations.names, equations.positions, strict=True):
        size = 0.1 * max(abs(p[position]), 1e-3)
        above, below = (
            evaluated([*p[:position], p[position] + change, *p[position + 1 :]])
            for change in (size, -size)
        )
        nonlinearity = np.abs(above + below - 2.0 * base)
        largest = np.maximum(np.abs(above - below), np.abs(base))
        if np.any(nonlinearity > NONLINEARITY_TOLERANCE * largest + 1e-300):
            what = f"the equations are not linear in {name}"
            raise ModelError(
                what, where="equation error on line", remedy=f"fix {name}, or use flightid identify"
            )
