"""The bank of delays on line, row by row, and its sensitivity to the start.

The filters equal one pass of `ident.banks.bank.run_bank` with its default settings, to rounding.
The input at the vehicle is the mean of the delayed stick over each interval, from the recent rows
alone. Waiting rows are filtered together and then tested for spikes; from a spike on they are
filtered again without it.

An extended Kalman filter is linearised at its current estimate: its covariance shrinks too early,
and its result depends on the start. This dependence is measured with further starts. Each chosen
quantity is changed by one sigma of its prior, up or down by the columns of a Hadamard matrix,
independently of the others (Plackett and Burman, Biometrika 33(4), 1946). The mean square of the
differences from the declared start is then, to first order, the variance due to a start drawn from
that prior. By the law of total variance it adds to the filter's own. The median replaces the mean,
so that single failed filters do not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ident.banks.bank import BankEstimate, likelihood_and_nis, sound_so_far
from ident.banks.delays import DELAYS
from ident.banks.equation_kernels import Legs, Tables, filter_stretch, tables_of
from ident.filters.problem import prior_std
from sim.declaration.model import System
from sim.errors import ModelError

# ---- The bank of delays one row at a time: a state and new rows in, a state for each row out

LONGEST_SPIKE = 3  # longest spike, samples in a row of one channel


class Rows(NamedTuple):
    """Rows as they arrive: ``time (N,)`` s, increasing; ``inputs (n_u, N)`` finite; ``outputs (m,
    N)`` in the System's order, NaN where missing.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


class BankState(NamedTuple):
    """State of the bank after a row; immutable.

    Attributes
    ----------
    mean : ``(n, B)``, covariance : ``(B, n, n)``, log_likelihood : ``(B,)``, sound : ``(B,)`` as in
        ``BankEstimate``.
    innovation : ``(m,)`` of the most likely filter in standard deviations, NaN where nothing was
        measured.
    expected : ``(m,)`` that filter's prediction of the row's samples, NaN where nothing was
        measured.
    skipped : ``(m,)`` samples of this row that were taken for spikes;
    streak : ``(m,)`` how many in a row.
    rows_seen : rows so far.
    past_time, past_inputs : ``(w,)`` and ``(n_u, w)``, the last rows as far back as the longest
        delay reaches.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    sound: np.ndarray
    innovation: np.ndarray
    expected: np.ndarray
    skipped: np.ndarray
    streak: np.ndarray
    rows_seen: int
    past_time: np.ndarray
    past_inputs: np.ndarray

    @property
    def time(self) -> float:
        """Time of the row, s."""
        return float(self.past_time[-1])

    @property
    def best(self) -> int:
        """Index of the most likely filter."""
        return int(self.log_likelihood.argmax())

    def std(self, run: int) -> np.ndarray:
        """Return the standard deviations of a filter, ``(n,)``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance[run]), 0.0))


@dataclass(frozen=True, eq=False)
class OnlineBank:
    """Constants of an on-line bank: the System with ``p`` (the delays in it), its tables, and the
    start.

    ``names``: the ``n`` states and free parameters, ``units`` those of the parameters. ``start``:
    ``(n,)`` for all filters or ``(n, B)``. ``gate``: of spikes, in standard deviations;
    ``interval``: s. ``memory``: s of inputs that are kept.
    """

    system: System
    names: tuple[str, ...]
    units: tuple[str, ...]
    delays: np.ndarray
    p: list[Any]
    tables: Tables
    start: np.ndarray
    covariance: np.ndarray
    gate: float
    interval: float
    memory: float

    @property
    def R(self) -> np.ndarray:
        """Covariance of the measurement noise, ``(m, m)``."""
        return self.tables.R


def online_bank(
    system: System,
    interval: float,
    delays: Sequence[float] = DELAYS,
    *,
    name: str = "delay",
    gate: float = np.inf,
) -> OnlineBank:
    """Prepare a bank.

    Parameters
    ----------
    system : compiled with ``online=True``, every noise level declared; its parameter ``name`` is
        held.
    interval : usual time between rows, s. A longer step is divided into parts of at most 1.5 times
        this time. A batch run uses the median of the whole record; its results are the same where
        the parts are the same.
    delays : increasing, s.
    gate : an innovation beyond so many standard deviations of the most likely filter is a spike,
        and the sample counts as missing for all filters; after ``LONGEST_SPIKE`` in a row it is
        used. The batch pass of the same rows has no gate: it equals this one where those
        samples are missing.

    Raises
    ------
    ModelError : equations that are not bilinear or ask for the time, an input that acts on an
        output directly, an undeclared noise level or prior.
    """
    free_names = system.parameters.free_names
    if name in free_names:
        raise ModelError("it is free", where=f"bank, {name}", remedy="hold it")
    values = system.parameters.values().tolist()
    density, variance = system.noise(values)
    for output, value in zip(system.output_names, variance, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise ModelError(
                "its measurement noise is not declared",
                where=f"output {output}",
                remedy="give its standard deviation",
            )
    for each in free_names:
        if system.declared_noise.process_density.get(each, 0.0):
            raise ModelError(
                "it is a random walk",
                where=f"on-line bank, {each}",
                remedy="use run_bank on the whole record",
            )
    tables = tables_of(
        system,
        values,
        np.array([*density, *[0.0] * len(free_names)]),
        np.array(variance, dtype=float),
    )
    if tables is None:
        raise ModelError(
            "its equations are not sums of a parameter times a state",
            where="on-line bank",
            remedy="use run_bank on the whole record",
        )
    if tables.h.feeds_through:
        raise ModelError(
            "an input acts on an output directly",
            where="on-line bank",
            remedy="use run_bank on the whole record",
        )
    std = [prior_std(system, each, state=True) for each in system.state_names] + [
        prior_std(system, each, state=False) for each in free_names
    ]
    grid = np.atleast_1d(np.asarray(delays, dtype=float))
    p: list[Any] = list(values)
    p[system.parameters.index(name)] = grid
    start = np.concatenate([system.initial.values(), system.parameters.values(free_names)])
    units = tuple(system.parameters[each].unit for each in free_names)
    names, memory = (*system.state_names, *free_names), float(grid.max())
    return OnlineBank(
        system,
        names,
        units,
        grid,
        p,
        tables,
        start,
        np.diag(np.square(std)),
        gate,
        interval,
        memory,
    )


def with_delays(
    bank: OnlineBank, delays: np.ndarray, start: np.ndarray | None = None
) -> OnlineBank:
    """Return the bank with other delays ``(B,)`` (s, in any order), and starts ``(n,)`` or ``(n,
    B)`` if given.
    """
    # The delays are the only held value that is an array.
    p = [delays if np.ndim(value) else value for value in bank.p]
    return replace(
        bank,
        delays=delays,
        p=p,
        start=bank.start if start is None else start,
        memory=max(bank.memory, float(delays.max())),
    )


def begin(bank: OnlineBank, rows: Rows) -> BankState:
    """Return the state after the first row, the only one in ``rows``."""
    B, m, n_u = len(bank.delays), len(bank.R), len(bank.system.inputs)
    x = np.array(
        np.broadcast_to(
            bank.start if bank.start.ndim == 2 else bank.start[:, None], (len(bank.names), B)
        )
    )
    P = np.array(np.broadcast_to(bank.covariance, (B, *bank.covariance.shape)), order="C")
    silent, none = np.full(m, np.nan), np.zeros(m, dtype=bool)
    before = BankState(
        x,
        P,
        np.zeros(B),
        np.ones(B, dtype=bool),
        silent,
        silent,
        none,
        np.zeros(m, dtype=int),
        0,
        rows.time[:0],
        rows.inputs[:, :0],
    )
    nodes = _Nodes(rows.time, rows.inputs, [range(0)], [], np.zeros((0, B, n_u)), [0], [0])
    return _states_after(bank, before, nodes, rows.outputs)[0]


def advance(bank: OnlineBank, state: BankState, rows: Rows) -> list[BankState]:
    """Return the states after each of ``rows``, which follow the state in time."""
    if rows.time.size == 0:
        return []
    known = state.past_time.size
    nodes, row = _nodes(bank, np.append(state.time, rows.time))
    held = np.concatenate([state.past_inputs[:, -1:], rows.inputs], axis=1)
    time = np.concatenate([state.past_time, nodes])
    inputs = np.concatenate([state.past_inputs, held[:, row]], axis=1)
    means = [
        np.asarray(each).reshape(len(time) - 1, -1)
        for each in bank.system.input_path(bank.p, list(inputs[:, :-1]), time)
    ]
    u = np.stack(np.broadcast_arrays(*means), axis=2)[known - 1 :]
    last = np.flatnonzero(np.diff(row, prepend=0)) + 1
    steps = [range(a, b) for a, b in zip([0, *last[:-1].tolist()], last.tolist(), strict=True)]
    # Nodes before the longest delay are dropped.
    at = known + last - 1
    oldest = np.maximum(np.searchsorted(time, time[at] - bank.memory, side="right") - 1, 0)
    path = _Nodes(
        time, inputs, steps, np.diff(time)[known - 1 :].tolist(), u, oldest.tolist(), at.tolist()
    )
    return _states_after(bank, state, path, rows.outputs)


class _Nodes(NamedTuple):
    """Nodes of the integration.

    All times and inputs, with those of the past; the steps between nodes that lead to each row,
    their sizes (s) and inputs at the vehicle ``(M, B, n_u)``; and for each row the oldest node that
    is still needed, and its own.
    """

    time: np.ndarray
    inputs: np.ndarray
    steps: list[range]
    dt: list[float]
    u: np.ndarray
    oldest: list[int]
    at: list[int]


def _nodes(bank: OnlineBank, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of the integration nodes after ``time[0]``, as in
    ``sim.propagation.make_grid``, and the row whose input holds from each node on.
    """
    gaps = np.diff(time)
    pieces = np.maximum(1, np.ceil(gaps / (1.5 * bank.interval) - 1e-9)).astype(int)
    if pieces.max() == 1:
        return time[1:], np.arange(1, len(time))
    before = np.repeat(np.arange(len(gaps)), pieces)
    within = np.arange(1, len(before) + 1) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    last = within == pieces[before]
    return np.where(
        last, time[before + 1], time[before] + gaps[before] * (within / pieces[before])
    ), np.where(last, before + 1, before)


def _states_after(
    bank: OnlineBank, state: BankState, nodes: _Nodes, outputs: np.ndarray
) -> list[BankState]:
    """States after the rows of ``nodes`` with their samples ``(m, K)``, NaN where missing."""
    z, count = outputs.copy(), outputs.shape[1]
    states: list[BankState] = []
    first, length = 0, count
    spikes: _Assessed | None = None
    with np.errstate(all="ignore"):
        while first < count:
            rows = slice(first, min(first + length, count))
            filtered, result = _filtered(bank, state, nodes, rows, z[:, rows], spikes)
            states += filtered
            first, state = first + len(filtered), filtered[-1] if filtered else state
            # After a spike, rows are filtered in growing parts, so that many spikes stay cheap.
            length = 1 if result is not None else 2 * length
            if result is not None:
                z[result.skipped, first] = np.nan
            spikes = result
    return states


class _Assessed(NamedTuple):
    """Test of one row's samples for spikes, ``(m,)`` each as in ``BankState``."""

    innovation: np.ndarray
    expected: np.ndarray
    skipped: np.ndarray
    streak: np.ndarray


def _filtered(
    bank: OnlineBank,
    before: BankState,
    nodes: _Nodes,
    rows: slice,
    z: np.ndarray,
    judged: _Assessed | None,
) -> tuple[list[BankState], _Assessed | None]:
    """States after ``rows`` up to the first with a new spike, and the test of that row.

    The first row is not tested again.
    """
    valid = ~np.isnan(z)
    missing = [None if column.all() else np.flatnonzero(~column) for column in valid.T]
    done = filter_stretch(
        bank.tables,
        Legs(nodes.steps[rows], nodes.dt, nodes.u, None, z.T[:, None, :, None], missing),
        before.mean,
        before.covariance,
    )
    gains, nis = likelihood_and_nis(done.innovation, valid)
    good = sound_so_far(done, nis, before.sound)
    total = np.where(
        good, before.log_likelihood + np.cumsum(np.where(good, gains, 0.0), axis=0), -np.inf
    )
    likely = np.concatenate([before.log_likelihood[None], total[:-1]]).argmax(axis=1)
    chosen = done.innovation[np.arange(len(likely)), likely]
    sizes = np.where(
        valid.T, chosen[:, :, 0] / np.sqrt(np.diagonal(chosen[:, :, 1:], axis1=1, axis2=2)), np.nan
    )
    expected = np.where(valid.T, z.T - chosen[:, :, 0], np.nan)
    wild, none = np.abs(sizes) > bank.gate, np.zeros(len(z), dtype=bool)
    suspicious, streak = bool(wild.any() or before.streak.any()), before.streak
    states: list[BankState] = []
    mean, covariance, seen = before.mean, before.covariance, before.rows_seen
    every = bool(good[-1].all())
    for k, row in enumerate(range(rows.start, rows.stop)):
        result = _Assessed(sizes[k], expected[k], none, streak)
        if k == 0 and judged is not None:
            result = judged
        elif suspicious and valid[:, k].any():
            result = _Assessed(
                sizes[k],
                expected[k],
                wild[k] & (streak < LONGEST_SPIKE),
                np.where(wild[k], streak + 1, 0),
            )
            if result.skipped.any():
                return states, result
        streak = result.streak
        mean = done.mean[k].T if every else np.where(good[k], done.mean[k].T, mean)
        covariance = (
            done.covariance[k]
            if every
            else np.where(good[k][:, None, None], done.covariance[k], covariance)
        )
        past = slice(nodes.oldest[row], nodes.at[row] + 1)
        states.append(
            BankState(
                mean,
                covariance,
                total[k],
                good[k],
                *result,
                seen + k + 1,
                nodes.time[past],
                nodes.inputs[:, past],
            )
        )
    return states, None


def bank_estimate(bank: OnlineBank, state: BankState) -> BankEstimate:
    """Return the state as a result of ``run_bank``, without normalised squares of the rows."""
    P = 0.5 * (state.covariance + np.swapaxes(state.covariance, 1, 2))
    log_likelihood = np.where(state.sound, state.log_likelihood, -np.inf)
    B = len(bank.delays)
    return BankEstimate(
        bank.names,
        state.mean,
        P,
        log_likelihood,
        np.zeros((0, B)),
        state.sound,
        np.ones(B, dtype=int),
    )


# ---- Dependence of an on-line estimate on its start

# median square of a standard normal variable (chi-square, one degree of freedom)
MEDIAN_SQUARE = 0.454936


class FinalStates(NamedTuple):
    """Results of K starts after each of N rows: ``mean (N, K, n)`` and ``delay (N, K)`` (s) of the
    most likely filter of each; ``sound (N, K)``.
    """

    mean: np.ndarray
    delay: np.ndarray
    sound: np.ndarray


class StartSpread(NamedTuple):
    """Uncertainty after each of N rows that comes from the start and the grid of delays.

    ``std (N, n)`` and ``delay (N,)`` (s) add to the standard deviations of the most likely filter;
    infinite if half of the starts diverged. ``differences (N, K, n)`` from the declared start.
    """

    std: np.ndarray
    delay: np.ndarray
    differences: np.ndarray


def moved_starts(bank: OnlineBank, factors: Sequence[str]) -> np.ndarray:
    """Starts ``(n, K)`` with the factors moved by one sigma of their prior; K is the smallest power
    of two above their number.

    Raises ModelError for a factor that the bank does not have.
    """
    missing = [name for name in factors if name not in bank.names]
    if missing:
        raise ModelError(
            "it is no state and no free parameter",
            where=f"other starts, {missing[0]}",
            remedy=f"name some of {', '.join(bank.names)}",
        )
    signs: np.ndarray = np.ones((1, 1))
    while signs.shape[1] <= len(factors):
        signs = np.kron([[1.0, 1.0], [1.0, -1.0]], signs)
    at = [bank.names.index(name) for name in factors]
    starts = np.repeat(bank.start[:, None], len(signs), axis=1)
    starts[at] += signs[:, 1 : 1 + len(at)].T * np.sqrt(np.diagonal(bank.covariance))[at, None]
    return starts


def bank_of_starts(bank: OnlineBank, starts: np.ndarray) -> OnlineBank:
    """Return all delays of a bank from each start ``(n, K)``, start by start, without a test for
    spikes.
    """
    count = starts.shape[1]
    return replace(
        with_delays(bank, np.tile(bank.delays, count), np.repeat(starts, len(bank.delays), axis=1)),
        gate=np.inf,
    )


def final_states_of(bank: OnlineBank, states: Sequence[BankState], delays: int) -> FinalStates:
    """Return the most likely filter of each start in states of a ``bank_of_starts`` with ``delays``
    delays a start.
    """
    K, n = len(bank.delays) // delays, len(bank.names)
    likely = np.array(
        [np.where(state.sound, state.log_likelihood, -np.inf) for state in states]
    ).reshape(-1, K, delays)
    best = likely.argmax(axis=2)
    means = np.array([state.mean for state in states]).reshape(-1, n, K, delays)
    mean = np.take_along_axis(means, best[:, None, :, None], axis=3)[:, :, :, 0].transpose(0, 2, 1)
    return FinalStates(mean, bank.delays[best], np.isfinite(likely.max(axis=2)))


def spread_of(bank: OnlineBank, states: Sequence[BankState], ends: FinalStates) -> StartSpread:
    """Return the spread of the starts about the declared one, whose bank has these ``states``,
    including the spacing of its grid of delays.
    """
    likely = np.array([np.where(state.sound, state.log_likelihood, -np.inf) for state in states])
    best, each = likely.argmax(axis=1), np.arange(len(states))
    low, high = np.maximum(best - 1, 0), np.minimum(best + 1, len(bank.delays) - 1)
    means = np.array([state.mean for state in states])
    slope = (means[each, :, high] - means[each, :, low]) / (bank.delays[high] - bank.delays[low])[
        :, None
    ]
    # A delay is uniform within one step of the grid.
    step = float(np.diff(bank.delays).mean())
    differences = ends.mean - means[each, :, best][:, None]
    typical = _median_variance(differences, ends.sound[:, :, None])
    return StartSpread(
        np.sqrt(typical + np.square(slope) * step**2 / 12.0),
        np.sqrt(_median_variance(ends.delay - bank.delays[best][:, None], ends.sound)),
        np.where(ends.sound[:, :, None], differences, 0.0),
    )


def spread_covariance(std: np.ndarray, differences: np.ndarray) -> np.ndarray:
    """Return the covariance ``(n, n)`` with the deviations ``std (n,)`` and the correlations of the
    differences ``(K, n)`` of one row.
    """
    products = differences.T @ differences
    scale = np.sqrt(np.diagonal(products))
    share = np.divide(std, scale, out=np.zeros_like(std), where=scale > 0)
    out = share[:, None] * products * share
    np.fill_diagonal(out, np.square(std))
    return out


def _median_variance(differences: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return the variances from the median square over the starts (second axis); infinite for a
    failed start.
    """
    return np.median(np.where(sound, np.square(differences), np.inf), axis=1) / MEDIAN_SQUARE
