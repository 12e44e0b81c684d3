"""Equation error in the frequency domain on recursive Fourier transforms, for streams.

Morelli, "Real-Time Parameter Estimation in the Frequency Domain", Journal of Guidance, Control, and
Dynamics 23(5), 2000; Klein and Morelli, "Aircraft System Identification", AIAA 2006, chapter 11.

Over the step from sample i to i + 1 an equation of motion says x_{i+1} - x_i = integral of f(x, u)
dt. Both sides, times exp(-j omega t_i), are summed up as the samples come, so that no sample is
kept and neither the beginning nor the end of the motion needs a term of its own. For equations that
are linear in their parameters, f = f_0 + sum_j theta_j f_j, this is a regression at each frequency;
a constant for each equation takes up biases and what the trim leaves. Unlike Morelli's, integrals
are those of Hermite and Simpson, exact to fourth order for inputs that are held or linear between
samples; the regression is in `ident.frequency_domain.online_regression`.
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
_THIRD_DIFFERENCE_VARIANCE = 20.0  # variance of a third difference of white noise of variance one


@dataclass(frozen=True, eq=False)
class OnlineEquations:
    """The equations of a System that are regressed.

    Attributes
    ----------
    system : the identified model.
    names : of its parameters, ``(q,)``; ``positions`` among all.
    states : rows of the System's states whose equations are used.
    readings : rows of its outputs that are no states.
    sources : of each state, the row of the output that measures it, -1 where the caller computes
        it.
    omega : rad/s, ``(F,)``, evenly spaced.
    unmixed : ``(n, n)``, states from their outputs: a vane ahead of the centre of gravity reads the
        pitch rate as well.
    hold : behaviour of the inputs between rows.
    """

    system: System
    names: tuple[str, ...]
    positions: tuple[int, ...]
    states: tuple[int, ...]
    readings: tuple[int, ...]
    sources: tuple[int, ...]
    omega: np.ndarray
    unmixed: np.ndarray
    hold: Hold = Hold.PREVIOUS

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the equations, states first."""
        rates = [self.system.state_names[k] for k in self.states]
        return (*rates, *(self.system.output_names[k] for k in self.readings))


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over the rows so far, e equations and F frequencies.

    Attributes
    ----------
    rows : number of rows used.
    time, x, u : of the last, ``(n,)`` and ``(r,)``; None before the first.
    left : ``(e, F)``, known sides.
    regressors : ``(e, q, F)``.
    constant : ``(e, F)``, transform of one.
    apart, beside : ``(F,)`` and ``(2F - 1,)``, sums of exp(-j omega t) at differences and sums of
        two frequencies.
    noisy : ``(e, n, q + 1, q + 1)``, squares of the slopes by each state of the regressors and,
        last, of the known side, over all samples.
    noise : ``(n + m,)``, sums of the noise deviations of the states and of the outputs that are no
        states, times the samples ``counted``.
    recent : ``(n + m, 3)``, the last samples of these.
    first : s, time of the first row.
    """

    rows: int
    time: float
    x: np.ndarray | None
    u: np.ndarray | None
    left: np.ndarray
    regressors: np.ndarray
    constant: np.ndarray
    apart: np.ndarray
    beside: np.ndarray
    noisy: np.ndarray
    noise: np.ndarray
    counted: np.ndarray
    recent: np.ndarray
    first: float = 0.0

    @property
    def noise_variance(self) -> np.ndarray:
        """Variance of the noise of a sample of each state and reading, ``(n + m,)``."""
        return np.asarray((self.noise / np.maximum(self.counted, 1.0)) ** 2)


def frequencies(
    low: float = LOWEST_FREQUENCY,
    high: float = HIGHEST_FREQUENCY,
    spacing: float = FREQUENCY_SPACING,
) -> np.ndarray:
    """Evenly spaced frequencies, rad/s, from ``low`` to ``high``, Hz."""
    count = max(round((high - low) / spacing), 3)
    return 2.0 * math.pi * np.linspace(low, high, count + 1)


def online_equations(
    system: System, omega: np.ndarray, measured: Sequence[str], computed: Sequence[str] = ()
) -> OnlineEquations:
    """Return the equations of a System for a stream.

    Parameters
    ----------
    measured : names of the outputs that the stream has.
    computed : states that the caller computes from the inputs; their equations are left out.

    Raises
    ------
    ModelError : a state that is not measured, an effect with a memory, no free parameter.
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
    unmixed = _unmixed(system, positions, sources)
    return OnlineEquations(
        system, names, positions, states, readings, tuple(sources), omega, unmixed
    )


def _unmixed(system: System, positions: Sequence[int], sources: Sequence[int]) -> np.ndarray:
    """States from the outputs of their names, ``(n, n)``.

    Raises ModelError where a free parameter, or a state that is computed, acts on these outputs.
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


def begin(equations: OnlineEquations) -> Sums:
    """Empty sums."""
    e, q = len(equations.states) + len(equations.readings), len(equations.names)
    n, f = len(equations.system.states), equations.omega.size
    watched = n + len(equations.readings)
    zero = np.zeros((e, f), dtype=complex)
    wide = np.zeros((e, q, f), dtype=complex)
    noisy, blank = np.zeros((e, n, q + 1, q + 1)), np.full((watched, 3), np.nan)
    differences, beside = np.zeros(f, dtype=complex), np.zeros(2 * f - 1, dtype=complex)
    return Sums(
        0,
        -math.inf,
        None,
        None,
        zero,
        wide,
        zero,
        differences,
        beside,
        noisy,
        np.zeros(watched),
        np.zeros(watched),
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
    time : s, ``(N,)``, increasing.
    inputs : ``(r, N)``, held or linear between rows as ``equations`` say.
    outputs : ``(m, N)`` in the System's order, NaN where a sample is missing; a row without one of
        the states is bridged.
    values : the last estimate of the parameters, for the curvature within a step; None for the
        start.
    computed : ``(n, N)``, states that the caller computes, in their rows.
    """
    n = len(equations.system.states)
    rows = [outputs[source] if source >= 0 else np.zeros(time.size) for source in equations.sources]
    x = equations.unmixed @ np.array(rows)
    if computed is not None:
        for k, source in enumerate(equations.sources):
            x[k] = computed[k] if source < 0 else x[k]
    there = np.all(np.isfinite(x), axis=0)
    if not there.any():
        return sums
    linear = equations.hold is Hold.LINEAR
    mean = _means_between(time, inputs, there, linear=linear)
    has_rows = sums.x is not None and sums.u is not None
    times = np.concatenate([[sums.time] if has_rows else [], time[there]])
    states = np.concatenate(
        [sums.x[:, None] if sums.x is not None else np.zeros((n, 0)), x[:, there]], axis=1
    )
    before = sums.u[:, None] if sums.u is not None else np.zeros((len(inputs), 0))
    u = np.concatenate([before, inputs[:, there] if linear else mean], axis=1)
    within = np.repeat(u[None, :, :-1], 3, axis=0)
    if linear and times.size > 1:
        # Simpson's rule gets the mean over interpolated rows as its middle value.
        means = np.concatenate([0.5 * (before + u[:, 1:2]) if has_rows else before, mean], axis=1)
        middle = 1.5 * means[:, : times.size - 1] - 0.25 * (u[:, :-1] + u[:, 1:])
        within = np.array([u[:, :-1], middle, u[:, 1:]])
    points = Points(equations, values)
    out = _with_steps(equations, sums, points, times, states, within)
    out = _with_readings(
        equations, out, points, time[there], x[:, there], inputs[:, there], outputs[:, there]
    )
    came = np.concatenate([x, outputs[list(equations.readings)]])[:, there]
    out = _with_noise(equations, out, points, times, states, u, came)
    kept = np.concatenate([sums.recent, came], axis=1)[:, -3:]
    return replace(
        out,
        rows=out.rows + int(there.sum()),
        time=float(times[-1]),
        x=states[:, -1],
        u=u[:, -1],
        recent=kept,
        first=sums.first if has_rows else float(times[0]),
    )


def _means_between(
    time: np.ndarray, inputs: np.ndarray, there: np.ndarray, *, linear: bool
) -> np.ndarray:
    """Return the mean inputs between successive used rows, over interpolated rows as well; ``(r,
    K)``.
    """
    at = np.flatnonzero(there)
    steps = 0.5 * (inputs[:, :-1] + inputs[:, 1:]) if linear else inputs[:, :-1]
    gained = np.cumsum(steps * np.diff(time), axis=1)
    whole = np.concatenate([np.zeros((len(inputs), 1)), gained], axis=1)
    spans = np.diff(time[at])
    between = np.diff(whole[:, at], axis=1) / spans
    return np.concatenate([between, inputs[:, at[-1:]]], axis=1)


@dataclass(frozen=True, eq=False)
class Points:
    """The System's rates and readings with their slopes by the parameters, at samples."""

    equations: OnlineEquations
    values: np.ndarray | None

    def of(
        self, function: Any, time: np.ndarray, x: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parts ``(rows, N)`` without parameters and slopes ``(rows, q, N)`` by them."""
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
        """Rates ``(n, N)`` with the last estimate."""
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
    points: Points,
    times: np.ndarray,
    states: np.ndarray,
    within: np.ndarray,
) -> Sums:
    """Sums with the increments of the states between the rows, and the integrals of their rates.

    ``within`` : ``(3, r, N - 1)``, inputs at the beginning, the middle and the end of each step.
    """
    if times.size < 2:
        return sums
    step = np.diff(times)
    first, last = states[:, :-1], states[:, 1:]
    begin_ = points.rate(times[:-1], first, within[0])
    end = points.rate(times[1:], last, within[2])
    middle = 0.5 * (first + last) + 0.125 * step * (begin_ - end)
    f = equations.system.f
    parts = [
        points.of(f, t, x, u)
        for t, x, u in zip(
            (times[:-1], times[:-1] + 0.5 * step, times[1:]),
            (first, middle, last),
            within,
            strict=True,
        )
    ]
    known, slopes = (
        sum(w * part[k] for w, part in zip((1.0, 4.0, 1.0), parts, strict=True)) * step / 6.0
        for k in (0, 1)
    )
    if not (np.all(np.abs(known) < LARGEST_NUMBER) and np.all(np.abs(slopes) < LARGEST_NUMBER)):
        what = "a rate is no finite number at the measured states"
        raise ModelError(
            what, where="equation error on line", remedy="check units and start values"
        )
    if not np.any(sums.apart):
        _refuse_nonlinear(equations, times[:-1], first, within[0])
    rows = list(equations.states)
    turns = np.exp(-1j * np.outer(times[:-1], equations.omega))
    spaced = equations.omega[1] - equations.omega[0]
    f_count = equations.omega.size
    e = len(rows)
    out = replace(
        sums,
        left=sums.left.copy(),
        regressors=sums.regressors.copy(),
        constant=sums.constant.copy(),
    )
    out.left[:e] += (last - first - known)[rows] @ turns
    out.regressors[:e] += slopes[rows] @ turns
    out.constant[:e] += step @ turns
    near = np.exp(-1j * np.outer(times[:-1], spaced * np.arange(f_count))).sum(axis=0)
    far = np.exp(
        -1j * np.outer(times[:-1], 2.0 * equations.omega[0] + spaced * np.arange(2 * f_count - 1))
    ).sum(axis=0)
    return replace(out, apart=sums.apart + near, beside=sums.beside + far)


def _with_readings(
    equations: OnlineEquations,
    sums: Sums,
    points: Points,
    time: np.ndarray,
    x: np.ndarray,
    u: np.ndarray,
    outputs: np.ndarray,
) -> Sums:
    """Return the sums with the outputs that are no states, sample by sample."""
    if not equations.readings:
        return sums
    known, slopes = points.of(equations.system.h, time, x, u)
    turns = np.exp(-1j * np.outer(time, equations.omega))
    out = replace(
        sums,
        left=sums.left.copy(),
        regressors=sums.regressors.copy(),
        constant=sums.constant.copy(),
    )
    for row, k in enumerate(equations.readings, start=len(equations.states)):
        there = np.isfinite(outputs[k])
        out.left[row] += (outputs[k] - known[k])[there] @ turns[there]
        out.regressors[row] += slopes[k][:, there] @ turns[there]
        out.constant[row] += turns[there].sum(axis=0)
    return out


def _with_noise(
    equations: OnlineEquations,
    sums: Sums,
    points: Points,
    times: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    came: np.ndarray,
) -> Sums:
    """Return the sums with the noise of the new samples ``came`` ``(n + m, N)``, by their third
    differences, and the states' share of the regressors and of the known side.
    """
    rows = np.concatenate([sums.recent, came], axis=1)
    third = np.diff(rows, 3, axis=1)
    noise, counted = sums.noise.copy(), sums.counted.copy()
    for k, row in enumerate(third):
        finite = row[np.isfinite(row)]
        if finite.size and (k >= len(equations.sources) or equations.sources[k] >= 0):
            noise[k] += (
                finite.size
                * SIGMA_PER_MEDIAN_DEVIATION
                * float(np.median(np.abs(finite)))
                / math.sqrt(_THIRD_DIFFERENCE_VARIANCE)
            )
            counted[k] += finite.size
    system, n = equations.system, len(equations.system.states)
    at, x, u = times[-1:], states[:, -1:], inputs[:, -1:]
    noisy = sums.noisy.copy()
    step = float(np.median(np.diff(times))) if times.size > 1 else 0.0

    def both(function: Any, x: np.ndarray) -> np.ndarray:
        known, slopes = points.of(function, at, x, u)
        return np.asarray(np.concatenate([slopes, known[:, None]], axis=1))

    f, h = both(system.f, x), both(system.h, x)
    for s in range(n):
        moved = x.copy()
        size = 1e-3 * max(abs(float(x[s, 0])), 1e-3)
        moved[s] += size
        for function, base, which, first, weight in (
            (system.f, f, equations.states, 0, step**2),
            (system.h, h, equations.readings, len(equations.states), 1.0),
        ):
            slope = (both(function, moved) - base)[:, :, 0] / size
            for row, k in enumerate(which, start=first):
                noisy[row, s] += came.shape[1] * weight * np.outer(slope[k], slope[k])
    return replace(sums, noisy=noisy, noise=noise, counted=counted)


def _refuse_nonlinear(
    equations: OnlineEquations, times: np.ndarray, x: np.ndarray, u: np.ndarray
) -> None:
    """Raise ModelError for a parameter in which a rate or reading is nonlinear."""
    system, few = equations.system, slice(0, 8)
    p = list(system.parameters.values())

    def at(values: list[float]) -> np.ndarray:
        given = (times[few], list(x[:, few]), list(u[:, few]), values)
        rows = (*system.f(*given), *system.h(*given))
        return np.array([np.broadcast_to(row, times[few].shape) for row in rows], dtype=float)

    base = at(p)
    for name, position in zip(equations.names, equations.positions, strict=True):
        size = 0.1 * max(abs(p[position]), 1e-3)
        ones = []
        for sign in (1.0, -1.0):
            moved = list(p)
            moved[position] = p[position] + sign * size
            ones.append(at(moved))
        bent = np.abs(ones[0] + ones[1] - 2.0 * base)
        tolerance = (
            NONLINEARITY_TOLERANCE * np.maximum(np.abs(ones[0] - ones[1]), np.abs(base)) + 1e-300
        )
        if np.any(bent > tolerance):
            what = f"the equations are not linear in {name}"
            raise ModelError(
                what, where="equation error on line", remedy=f"fix {name}, or use flightid identify"
            )
