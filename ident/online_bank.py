"""The bank of delays one row at a time: a state and new rows in, a state for each row out.

The same filters as one pass of `ident.bank.run_bank` with its usual settings, equal to rounding: the same covariances and updates.
What differs is where the numbers come from. The input at the vehicle is the mean of the delayed stick over each interval, from
the recent rows alone; values and Jacobians come from the table of `ident.bilinear`; and a Runge-Kutta step of equations that are
affine in the states, under an input that is held, is four terms of a Taylor series. Rows that wait are taken together, which
spares calls of the input path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ident.bank import BankEstimate
from ident.bank_pass import all_sound, innovation_rows, moved_covariance, scalar_updates, sound_runs
from ident.bilinear import Bilinear, bilinear
from ident.delay_bank import DELAYS
from ident.keeping import LARGEST
from ident.setup import prior_std, with_free
from ident.transition import noise_of_series
from sim.errors import ModelError
from sim.system import System

_TERMS = 3  # of the fundamental matrix, as in FilterSettings
LONGEST_SPIKE = 3  # samples in a row of one channel; what lasts longer is the motion


class Rows(NamedTuple):
    """Rows as they arrive: ``time (N,)`` s, increasing; ``inputs (n_u, N)`` finite; ``outputs (m, N)`` in the System's order, NaN where missing."""

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


class BankState(NamedTuple):
    """The bank after a row; nothing in it is ever changed.

    Attributes
    ----------
    mean : ``(n, B)``, covariance : ``(B, n, n)``, log_likelihood : ``(B,)``, sound : ``(B,)`` as in ``BankEstimate``.
    innovation : ``(m,)`` of the most likely filter in standard deviations, NaN where nothing was measured.
    skipped : ``(m,)`` samples of this row that were taken for spikes; streak : ``(m,)`` how many in a row.
    rows_seen : rows so far.
    past_time, past_inputs : ``(w,)`` and ``(n_u, w)``, the last rows as far back as the longest delay reaches.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    sound: np.ndarray
    innovation: np.ndarray
    skipped: np.ndarray
    streak: np.ndarray
    rows_seen: int
    past_time: np.ndarray
    past_inputs: np.ndarray

    @property
    def time(self) -> float:
        """Of the row, s."""
        return float(self.past_time[-1])

    @property
    def best(self) -> int:
        """The most likely filter."""
        return int(self.log_likelihood.argmax())

    def std(self, run: int) -> np.ndarray:
        """Standard deviations of a filter, ``(n,)``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance[run]), 0.0))


@dataclass(frozen=True, eq=False)
class OnlineBank:
    """What stays the same from row to row: the System with ``p`` (the delays in it), tables of ``f`` and ``h``, noise and start.

    ``names`` are the ``n`` states and free parameters; ``gate`` is in standard deviations, ``interval`` in s.
    """

    system: System
    names: tuple[str, ...]
    delays: np.ndarray
    p: list[Any]
    f: Bilinear
    h: Bilinear
    noise: Callable[[list[np.ndarray], np.ndarray, float], np.ndarray | None]
    start: np.ndarray
    covariance: np.ndarray
    R: np.ndarray
    gate: float
    interval: float
    no_spike: np.ndarray
    no_streak: np.ndarray


def online_bank(system: System, interval: float, delays: Sequence[float] = DELAYS, *, name: str = "delay", gate: float = np.inf) -> OnlineBank:
    """Prepare a bank.

    Parameters
    ----------
    system : compiled with ``online=True``, every noise level declared; its parameter ``name`` is held.
    interval : usual time between rows, s; what is longer is cut into parts of at most one and a half times that. A batch run takes the
        median of the whole record, and is equal where that leads to the same parts.
    delays : increasing, s.
    gate : an innovation beyond so many standard deviations of the most likely filter is a spike, and the sample counts as missing for
        all filters; after ``LONGEST_SPIKE`` in a row it is believed. The batch pass of the same rows has no gate: it
        equals this one where those samples are missing.

    Raises
    ------
    ModelError : equations that are not bilinear, an input that acts on an output directly, an undeclared noise level or prior.
    """
    n_x, free_names = len(system.states), system.parameters.free_names
    free = [system.parameters.index(each) for each in free_names]
    held = system.parameters.values().tolist()
    if name in free_names:
        raise ModelError("it is free", where=f"bank, {name}", remedy="hold it")
    n, n_u = n_x + len(free), len(system.inputs)

    def split(w: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        return w[:n_x], w[n:], with_free(held, free, w[n_x:n])

    f = bilinear(lambda w: system.f(0.0, *split(w)), n, n_x, n_u)
    h = bilinear(lambda w: system.h(0.0, *split(w)), n, n_x, n_u)
    if f is None or h is None:
        raise ModelError("its equations are not sums of a parameter times a state", where="on-line bank", remedy="use run_bank on the whole record")
    if h.feeds_through:
        raise ModelError("an input acts on an output directly", where="on-line bank", remedy="use run_bank on the whole record")
    density, variance = system.noise(held)
    for output, value in zip(system.output_names, variance, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise ModelError("its measurement noise is not declared", where=f"output {output}", remedy="give its standard deviation")
    for each in free_names:
        if system.declared_noise.process_density.get(each, 0.0):
            raise ModelError("it is a random walk", where=f"on-line bank, {each}", remedy="use run_bank on the whole record")
    std = [prior_std(system, each, state=True) for each in system.state_names] + [prior_std(system, each, state=False) for each in free_names]
    grid = np.atleast_1d(np.asarray(delays, dtype=float))
    p: list[Any] = list(held)
    p[system.parameters.index(name)] = grid
    start = np.concatenate([system.initial.values(), system.parameters.values(free_names)])
    return OnlineBank(
        system,
        (*system.state_names, *free_names),
        grid,
        p,
        f,
        h,
        noise_of_series(n_x, np.array([*density, *[0.0] * len(free)]), _TERMS),
        start,
        np.diag(np.square(std)),
        np.diag(np.array(variance, dtype=float)),
        gate,
        interval,
        np.zeros(len(variance), dtype=bool),
        np.zeros(len(variance), dtype=int),
    )


def begin(bank: OnlineBank, rows: Rows) -> BankState:
    """The state after the first row, the only one in ``rows``."""
    B, m = len(bank.delays), len(bank.R)
    x = np.repeat(bank.start[:, None], B, axis=1)
    P = np.array(np.broadcast_to(bank.covariance, (B, *bank.covariance.shape)), order="C")
    silent = np.full(m, np.nan)
    before = BankState(x, P, np.zeros(B), np.ones(B, dtype=bool), silent, bank.no_spike, bank.no_streak, 0, rows.time[:1], rows.inputs[:, :1])
    with np.errstate(all="ignore"):
        return _updated(bank, before, x, P, _w(bank, x), rows.outputs[:, 0], before.past_time, before.past_inputs)


def advance(bank: OnlineBank, state: BankState, rows: Rows) -> list[BankState]:
    """The states after each of ``rows``, which follow the state's in time."""
    if rows.time.size == 0:
        return []
    known = state.past_time.size
    nodes, row = _nodes(bank, np.append(state.time, rows.time))
    held = np.concatenate([state.past_inputs[:, -1:], rows.inputs], axis=1)
    time = np.concatenate([state.past_time, nodes])
    inputs = np.concatenate([state.past_inputs, held[:, row]], axis=1)
    means = [np.asarray(each).reshape(len(time) - 1, -1) for each in bank.system.input_path(bank.p, list(inputs[:, :-1]), time)]
    samples = [rows.outputs[:, k] for k in range(rows.time.size)]
    way = _Way(time, inputs, means, known, (np.diff(row, prepend=0) > 0).tolist(), samples)
    with np.errstate(all="ignore"):
        if state.sound.all():
            # Breakdowns are rare: they are looked for once in all the rows, and only then row by row.
            out = _through(bank, state, way, careful=False)
            if _all_were_sound(out):
                return out
        return _through(bank, state, way, careful=True)


class _Way(NamedTuple):
    """Nodes to go through: times and inputs from the ``known`` past on, the input's mean before each but the first, and at which new nodes
    there is a row, whose samples follow."""

    time: np.ndarray
    inputs: np.ndarray
    means: list[np.ndarray]
    known: int
    measured: list[bool]
    samples: list[np.ndarray]


def _nodes(bank: OnlineBank, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times at which the filters stop after ``time[0]``, as in ``sim.grid.make_grid``, and the row whose input holds from each on."""
    gaps = np.diff(time)
    pieces = np.maximum(1, np.ceil(gaps / (1.5 * bank.interval) - 1e-9)).astype(int)
    if pieces.max() == 1:
        return time[1:], np.arange(1, len(time))
    before = np.repeat(np.arange(len(gaps)), pieces)
    within = np.arange(1, len(before) + 1) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    last = within == pieces[before]
    return np.where(last, time[before + 1], time[before] + gaps[before] * (within / pieces[before])), np.where(last, before + 1, before)


def _through(bank: OnlineBank, state: BankState, way: _Way, *, careful: bool) -> list[BankState]:
    # The node at which the longest delay ends: older ones are forgotten.
    oldest = np.maximum(np.searchsorted(way.time, way.time - bank.delays[-1], side="right") - 1, 0).tolist()
    n, w, steps, samples = len(bank.names), _w(bank, state.mean), np.diff(way.time).tolist(), iter(way.samples)
    out: list[BankState] = []
    for k, measured in enumerate(way.measured, start=way.known):
        for row, mean in enumerate(way.means, start=1 + n):
            w[:, row] = mean[k - 1]
        x, P = _predicted(bank, state, w, steps[k - 1])
        if not measured:
            state = state._replace(mean=x, covariance=P)
            continue
        past = slice(oldest[k], k + 1)
        state = _updated(bank, state, x, P, w, next(samples), way.time[past], way.inputs[:, past], careful)
        out.append(state)
    return out


def _all_were_sound(states: list[BankState]) -> bool:
    """Whether no run broke down on the way: what is not finite stays so, a negative variance may not."""
    last = states[-1]
    n = len(last.mean)
    lowest = min(state.covariance.reshape(-1, n * n)[:, :: n + 1].min() for state in states)
    return lowest >= 0.0 and all_sound(last.mean, last.covariance, last.log_likelihood)


def bank_estimate(bank: OnlineBank, state: BankState) -> BankEstimate:
    """The state in the terms of ``run_bank``; no row's nis is kept."""
    P = 0.5 * (state.covariance + np.swapaxes(state.covariance, 1, 2))
    log_likelihood = np.where(state.sound, state.log_likelihood, -np.inf)
    B = len(bank.delays)
    return BankEstimate(bank.names, state.mean, P, log_likelihood, np.zeros((0, B)), state.sound, np.ones(B, dtype=int))


def _w(bank: OnlineBank, x: np.ndarray) -> np.ndarray:
    """Room for one, states, parameters and inputs of each run; the first two are filled."""
    w = np.zeros((x.shape[1], 1 + len(x) + len(bank.system.inputs)))
    w[:, 0], w[:, 1 : 1 + len(x)] = 1.0, x.T
    return w


def _predicted(bank: OnlineBank, state: BankState, w: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances over one interval with the inputs in ``w``; the states' entries of ``w`` move along."""
    n, n_x = len(bank.names), len(bank.system.states)
    first = bank.f.at(w) * dt
    A = first[:, :, :n_x]
    second = A @ first * 0.5
    third = A @ second[:, :, n:] * (1.0 / 3.0)
    fourth = A @ third * 0.25
    D = first + second
    x = state.mean.copy()
    x[:n_x] += (D[:, :, n:] + (third + fourth))[:, :, 0].T
    w[:, 1 : 1 + n_x] = x[:n_x].T
    return x, moved_covariance(state.covariance, D[:, :, :n], bank.noise([first, second], D, dt), None, dt)


def _updated(
    bank: OnlineBank,
    before: BankState,
    x: np.ndarray,
    P: np.ndarray,
    w: np.ndarray,
    z: np.ndarray,
    time: np.ndarray,
    inputs: np.ndarray,
    careful: bool = True,
) -> BankState:
    """The state after an update with the samples in ``z (m,)``; ``w`` holds ``x`` and is left holding the new mean.

    Unless it is ``careful``, the runs are taken for sound.
    """
    m, n = len(z), len(x)
    skipped, streak = bank.no_spike, bank.no_streak
    use = [i for i, value in enumerate(z.tolist()) if value == value]
    if not use:
        soundness = before.sound & sound_runs(x, P) if careful else before.sound
        x, P = _kept(before, x, P, soundness)
        w[:, 1 : 1 + n] = x.T
        return BankState(x, P, before.log_likelihood, soundness, np.full(m, np.nan), skipped, before.streak, before.rows_seen + 1, time, inputs)
    expected = bank.h.at(w)
    H, y = expected[:, :, :n], z[:, None] - expected[:, :, n].T
    first = innovation_rows(P, H, y, bank.R) if len(use) == m else innovation_rows(P, H[:, use], y[use], bank.R[np.ix_(use, use)])
    likely = first[before.log_likelihood.argmax()]
    size = likely[:, n] / np.sqrt(likely.reshape(-1)[n + 1 :: n + 2 + len(use)])
    wild_ones = any(abs(value) > bank.gate for value in size.tolist())
    if len(use) < m:
        size = _spread(size, use, m)
    if wild_ones:
        wild = np.abs(size) > bank.gate
        skipped = wild & (before.streak < LONGEST_SPIKE)
        streak = np.where(wild, before.streak + 1, 0)
        if skipped.any():
            done = _updated(bank, before._replace(streak=np.full(m, LONGEST_SPIKE)), x, P, w, np.where(skipped, np.nan, z), time, inputs, careful)
            return done._replace(innovation=size, skipped=skipped, streak=streak)
    new_x, new_P, gained, squared = scalar_updates(x, P, first)
    log_likelihood, sound = before.log_likelihood + gained, before.sound
    if careful and not (sound.all() and all_sound(new_x, new_P, squared)):
        sound = sound & sound_runs(new_x, new_P) & (np.abs(squared) < LARGEST)
        new_x, new_P = _kept(before, new_x, new_P, sound)
        log_likelihood = np.where(sound, log_likelihood, -np.inf)
    w[:, 1 : 1 + n] = new_x.T
    return BankState(new_x, new_P, log_likelihood, sound, size, skipped, streak, before.rows_seen + 1, time, inputs)


def _spread(values: np.ndarray, at: list[int], m: int) -> np.ndarray:
    out = np.full(m, np.nan)
    out[at] = values
    return out


def _kept(before: BankState, x: np.ndarray, P: np.ndarray, sound: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the runs that broke down were before."""
    if sound.all():
        return x, P
    return np.where(sound, x, before.mean), np.where(sound[:, None, None], P, before.covariance)
