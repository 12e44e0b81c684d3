"""Bank of filters with different delays on line, row by row, and the dependence of its estimate on
the start.

The filters equal one pass of `ident.banks.bank.run_bank` with its default settings, except for
rounding. The input at the vehicle is the mean of the delayed stick over each interval, so that only
recent rows are needed. New rows are filtered together and then tested for spikes. From a spike on,
the rows are filtered again without it.

An extended Kalman filter is linearised at its current estimate. Its covariance therefore decreases
too early, and its result depends on the start. Filters with other starts measure this dependence.
Each chosen quantity is changed by one sigma of its prior. The columns of a Hadamard matrix give the
signs, so that the changes are uncorrelated (Plackett and Burman, Biometrika 33(4), 1946). To first
order, the mean square of the differences from the declared start is the variance due to a start
drawn from the priors. By the law of total variance it is added to the variance of the filter. The
median of the squares is used in place of the mean, so that single diverged filters have no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ident.banks.bank import BankEstimate, likelihood_and_nis, sound_so_far
from ident.banks.block_kernels import BlockInputs, filter_samples, table_kernel
from ident.banks.delays import DELAYS
from ident.bilinear_table import Tables, equation_tables
from ident.filters.problem import prior_covariance, refuse_undeclared_noise
from sim.declaration.model import System
from sim.errors import ModelError

# ---- The bank row by row

LONGEST_SPIKE = 3  # longest spike, samples in a row of one channel
LONGEST_STEP = 1.5  # longest integration step, in usual intervals between rows


class Rows(NamedTuple):
    """N rows of a record as they arrive.

    Attributes
    ----------
    time : ``(N,)``, s, increasing.
    inputs : ``(n_u, N)``, finite, in the order of the System.
    outputs : ``(m, N)``, NaN where missing, in the order of the System.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


class BankState(NamedTuple):
    """State of the B filters of the bank after a row. It is immutable.

    Attributes
    ----------
    mean, covariance, log_likelihood : as in ``BankEstimate``.
    sound : ``(B,)`` False for a diverged filter.
    innovation : ``(m,)`` innovations of the most likely filter in standard deviations, NaN where
        nothing was measured.
    expected : ``(m,)`` prediction of the samples by the most likely filter, NaN where nothing was
        measured.
    skipped : ``(m,)`` whether the sample of this row was left out as a spike.
    streak : ``(m,)`` number of adjacent samples beyond the gate, up to this row.
    rows_seen : number of rows so far.
    past_time : ``(w,)``, s, times of the last rows, as far back as the longest delay.
    past_inputs : ``(n_u, w)`` their inputs.
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
        """Return the standard deviations ``(n,)`` of filter number ``run``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance[run]), 0.0))


@dataclass(frozen=True, eq=False)
class OnlineBank:
    """Constants of an on-line bank of B filters.

    Attributes
    ----------
    system : the System.
    names : names of the n states and free parameters.
    units : units of the free parameters.
    delays : ``(B,)``, s.
    p : all parameters of the System; the entry of the delay is the array ``delays``.
    tables : coefficients of the bilinear equations, and noise.
    start : ``(n,)`` mean at the start of all filters, or ``(n, B)`` mean of each filter.
    covariance : ``(n, n)`` at the start.
    gate : largest innovation of a sample that is no spike, in standard deviations.
    interval : usual time between rows, s.
    memory : time, s, for which past inputs are kept.
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
    """Return an on-line bank.

    Parameters
    ----------
    system : System compiled with ``online=True``, with all noise levels declared.
    interval : usual time between rows, s. A longer step is divided into parts of at most
        ``LONGEST_STEP`` times this time. A batch run uses the median interval of the whole record;
        its results are the same if the parts are the same.
    delays : s, increasing.
    name : name of the parameter that is the delay; it must be fixed.
    gate : a sample whose innovation in the most likely filter exceeds this number of standard
        deviations is a spike, and counts as missing for all filters. After ``LONGEST_SPIKE`` spikes
        in a row the sample is used. A batch pass has no gate: it gives the same result if the
        spikes are missing from its record.

    Raises
    ------
    ModelError : if equations are not bilinear or depend on time, if an input acts on an output
        directly, or if a noise level or prior is not declared.
    """
    free_names = system.parameters.free_names
    if name in free_names:
        raise ModelError("the parameter is free", where=f"bank, {name}", remedy="fix it")
    values = system.parameters.values().tolist()
    density, variance = system.noise(values)
    refuse_undeclared_noise(system, variance)
    for parameter in free_names:
        if system.declared_noise.process_density.get(parameter, 0.0):
            raise ModelError(
                "the parameter is a random walk",
                where=f"on-line bank, {parameter}",
                remedy="use run_bank on the whole record",
            )
    tables = equation_tables(
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
    grid = np.atleast_1d(np.asarray(delays, dtype=float))
    p: list[Any] = list(values)
    p[system.parameters.index(name)] = grid
    start = np.concatenate([system.initial.values(), system.parameters.values(free_names)])
    units = tuple(system.parameters[parameter].unit for parameter in free_names)
    names, memory = (*system.state_names, *free_names), float(grid.max())
    return OnlineBank(
        system,
        names,
        units,
        grid,
        p,
        tables,
        start,
        prior_covariance(system),
        gate,
        interval,
        memory,
    )


def with_delays(
    bank: OnlineBank, delays: np.ndarray, start: np.ndarray | None = None
) -> OnlineBank:
    """Return the bank with other delays ``(B,)``, s, in any order.

    ``start`` is the new mean at the start, ``(n,)`` or ``(n, B)``; None keeps the present one.
    """
    # Only the entry of the delay is an array.
    p = [delays if np.ndim(value) else value for value in bank.p]
    return replace(
        bank,
        delays=delays,
        p=p,
        start=bank.start if start is None else start,
        memory=max(bank.memory, float(delays.max())),
    )


def begin(bank: OnlineBank, rows: Rows) -> BankState:
    """Return the state after the first row. ``rows`` has this row alone."""
    B, m, n_u = len(bank.delays), len(bank.R), len(bank.system.inputs)
    start = bank.start if bank.start.ndim == 2 else bank.start[:, None]
    no_innovation = np.full(m, np.nan)
    before = BankState(
        mean=np.array(np.broadcast_to(start, (len(bank.names), B))),
        covariance=np.array(
            np.broadcast_to(bank.covariance, (B, *bank.covariance.shape)), order="C"
        ),
        log_likelihood=np.zeros(B),
        sound=np.ones(B, dtype=bool),
        innovation=no_innovation,
        expected=no_innovation,
        skipped=np.zeros(m, dtype=bool),
        streak=np.zeros(m, dtype=int),
        rows_seen=0,
        past_time=rows.time[:0],
        past_inputs=rows.inputs[:, :0],
    )
    nodes = _Nodes(rows.time, rows.inputs, [range(0)], [], np.zeros((0, B, n_u)), [0], [0])
    return _states_after(bank, before, nodes, rows.outputs)[0]


def advance(bank: OnlineBank, state: BankState, rows: Rows) -> list[BankState]:
    """Return the states after each of ``rows``, which are later than the state."""
    if rows.time.size == 0:
        return []
    past = state.past_time.size
    node_time, row_of_node = _node_times(bank, np.append(state.time, rows.time))
    inputs_by_row = np.concatenate([state.past_inputs[:, -1:], rows.inputs], axis=1)
    time = np.concatenate([state.past_time, node_time])
    inputs = np.concatenate([state.past_inputs, inputs_by_row[:, row_of_node]], axis=1)
    means = [
        np.asarray(mean).reshape(len(time) - 1, -1)
        for mean in bank.system.input_path(bank.p, list(inputs[:, :-1]), time)
    ]
    u = np.stack(np.broadcast_arrays(*means), axis=2)[past - 1 :]
    ends = np.flatnonzero(np.diff(row_of_node, prepend=0)) + 1
    steps = [range(a, b) for a, b in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True)]
    last = past + ends - 1
    oldest = np.maximum(np.searchsorted(time, time[last] - bank.memory, side="right") - 1, 0)
    nodes = _Nodes(
        time, inputs, steps, np.diff(time)[past - 1 :].tolist(), u, oldest.tolist(), last.tolist()
    )
    return _states_after(bank, state, nodes, rows.outputs)


class _Nodes(NamedTuple):
    """Nodes of the integration over the past and K new rows, with M steps over the new rows.

    Attributes
    ----------
    time, inputs : ``(w + M,)`` times, s, and ``(n_u, w + M)`` inputs at all nodes.
    steps : for each new row, the positions of the steps from the row before.
    dt : size of each step, s.
    u : ``(M, B, n_u)`` inputs at the vehicle during each step.
    oldest : position of the oldest node that is still needed after each new row.
    last : position of the node at each new row.
    """

    time: np.ndarray
    inputs: np.ndarray
    steps: list[range]
    dt: list[float]
    u: np.ndarray
    oldest: list[int]
    last: list[int]


def _node_times(bank: OnlineBank, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the times ``(M,)`` of the integration nodes after ``time[0]``, as in
    ``sim.propagation.make_grid``, and for each node the row whose input acts from this node on.
    """
    gaps = np.diff(time)
    parts = np.maximum(1, np.ceil(gaps / (LONGEST_STEP * bank.interval) - 1e-9)).astype(int)
    if parts.max() == 1:
        return time[1:], np.arange(1, len(time))
    gap = np.repeat(np.arange(len(gaps)), parts)  # position of the gap of each node
    part = np.arange(1, len(gap) + 1) - np.repeat(np.cumsum(parts) - parts, parts)
    at_row = part == parts[gap]
    inside = time[gap] + gaps[gap] * (part / parts[gap])
    return np.where(at_row, time[gap + 1], inside), np.where(at_row, gap + 1, gap)


def _states_after(
    bank: OnlineBank, state: BankState, nodes: _Nodes, outputs: np.ndarray
) -> list[BankState]:
    """Return the states after the rows of ``nodes`` with ``outputs (m, K)``, NaN if missing."""
    z, count = outputs.copy(), outputs.shape[1]
    states: list[BankState] = []
    first, length = 0, count
    spike_test: _SpikeTest | None = None
    with np.errstate(all="ignore"):
        while first < count:
            rows = slice(first, min(first + length, count))
            new_states, spike_test = _filtered(bank, state, nodes, rows, z[:, rows], spike_test)
            states += new_states
            if new_states:
                first, state = first + len(new_states), new_states[-1]
            if spike_test is None:
                length = 2 * length
            else:
                # After a spike, blocks begin with one row and grow, so that few rows are repeated.
                length = 1
                z[spike_test.skipped, first] = np.nan
    return states


class _SpikeTest(NamedTuple):
    """Test of the samples of one row for spikes, ``(m,)`` each, as in ``BankState``."""

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
    first_test: _SpikeTest | None,
) -> tuple[list[BankState], _SpikeTest | None]:
    """Return the states after each of ``rows`` before the first row with a spike, and the spike
    test of that row; None in its place if no row has a spike.

    ``z (m, K)`` are the samples of the rows. ``first_test`` is the test of the first row if it was
    made before; the row is then not tested again.
    """
    valid = ~np.isnan(z)
    missing = [None if column.all() else np.flatnonzero(~column) for column in valid.T]
    inputs = BlockInputs(nodes.dt, nodes.u, None)
    kernel = table_kernel(bank.tables, inputs, before.mean, before.covariance)
    samples = z.T[:, None, :, None]
    result = filter_samples(kernel, bank.R, nodes.steps[rows], samples, missing)
    gains, nis = likelihood_and_nis(result.innovation, valid)
    sound = sound_so_far(result, nis, before.sound)
    log_likelihood = before.log_likelihood + np.cumsum(np.where(sound, gains, 0.0), axis=0)
    log_likelihood = np.where(sound, log_likelihood, -np.inf)
    # the most likely filter before each row
    best = np.concatenate([before.log_likelihood[None], log_likelihood[:-1]]).argmax(axis=1)
    best_innovation = result.innovation[np.arange(len(best)), best]
    std = np.sqrt(np.diagonal(best_innovation[:, :, 1:], axis1=1, axis2=2))
    sizes = np.where(valid.T, best_innovation[:, :, 0] / std, np.nan)
    expected = np.where(valid.T, z.T - best_innovation[:, :, 0], np.nan)
    outside = np.abs(sizes) > bank.gate
    to_test, streak = bool(outside.any() or before.streak.any()), before.streak
    states: list[BankState] = []
    mean, covariance = before.mean, before.covariance
    all_sound = bool(sound[-1].all())
    for k, row in enumerate(range(rows.start, rows.stop)):
        test = _SpikeTest(sizes[k], expected[k], np.zeros(len(z), dtype=bool), streak)
        if k == 0 and first_test is not None:
            test = first_test
        elif to_test and valid[:, k].any():
            spike = outside[k] & (streak < LONGEST_SPIKE)
            test = _SpikeTest(sizes[k], expected[k], spike, np.where(outside[k], streak + 1, 0))
            if spike.any():
                return states, test
        streak = test.streak
        if all_sound:
            mean, covariance = result.mean[k].T, result.covariance[k]
        else:
            # Diverged filters keep their last sound values.
            mean = np.where(sound[k], result.mean[k].T, mean)
            covariance = np.where(sound[k][:, None, None], result.covariance[k], covariance)
        past = slice(nodes.oldest[row], nodes.last[row] + 1)
        states.append(
            BankState(
                mean,
                covariance,
                log_likelihood[k],
                sound[k],
                *test,
                before.rows_seen + k + 1,
                nodes.time[past],
                nodes.inputs[:, past],
            )
        )
    return states, None


def bank_estimate(bank: OnlineBank, state: BankState) -> BankEstimate:
    """Return the state in the form of a result of ``run_bank``, without the NIS of the rows."""
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


class MostLikelyByStart(NamedTuple):
    """Most likely filter of each of K starts after each of N rows.

    Attributes
    ----------
    mean : ``(N, K, n)`` mean of this filter.
    delay : ``(N, K)`` its delay, s.
    sound : ``(N, K)`` False if all filters of the start have diverged.
    """

    mean: np.ndarray
    delay: np.ndarray
    sound: np.ndarray


class StartSpread(NamedTuple):
    """Uncertainty due to the start and to the grid of delays after each of N rows.

    It adds to the uncertainty of the most likely filter. It is infinite if half of the K starts
    have diverged.

    Attributes
    ----------
    std : ``(N, n)`` standard deviations of states and parameters.
    delay : ``(N,)`` standard deviation of the delay, s.
    differences : ``(N, K, n)`` mean of each start minus the mean of the declared start.
    """

    std: np.ndarray
    delay: np.ndarray
    differences: np.ndarray


def changed_starts(bank: OnlineBank, factors: Sequence[str]) -> np.ndarray:
    """Return K starts ``(n, K)``, in which the quantities ``factors`` are changed by plus or minus
    one sigma of their priors. K is the smallest power of two above the number of factors.

    Raises
    ------
    ModelError : if a factor is no state and no free parameter of the bank.
    """
    missing = [name for name in factors if name not in bank.names]
    if missing:
        raise ModelError(
            "it is neither a state nor a free parameter",
            where=f"other starts, {missing[0]}",
            remedy=f"choose from {', '.join(bank.names)}",
        )
    signs: np.ndarray = np.ones((1, 1))
    while signs.shape[1] <= len(factors):
        signs = np.kron([[1.0, 1.0], [1.0, -1.0]], signs)
    at = [bank.names.index(name) for name in factors]
    starts = np.repeat(bank.start[:, None], len(signs), axis=1)
    starts[at] += signs[:, 1 : 1 + len(at)].T * np.sqrt(np.diagonal(bank.covariance))[at, None]
    return starts


def bank_of_starts(bank: OnlineBank, starts: np.ndarray) -> OnlineBank:
    """Return a bank with a filter for each of K ``starts (n, K)`` and each delay of ``bank``,
    without a spike test. The filters of one start are adjacent.
    """
    count = starts.shape[1]
    return replace(
        with_delays(bank, np.tile(bank.delays, count), np.repeat(starts, len(bank.delays), axis=1)),
        gate=np.inf,
    )


def most_likely_by_start(
    bank: OnlineBank, states: Sequence[BankState], delays: int
) -> MostLikelyByStart:
    """Return the most likely filter of each start from the states of a ``bank_of_starts``.

    ``delays`` is the number of delays of each start.
    """
    K, n = len(bank.delays) // delays, len(bank.names)
    likely = np.array(
        [np.where(state.sound, state.log_likelihood, -np.inf) for state in states]
    ).reshape(-1, K, delays)
    best = likely.argmax(axis=2)
    means = np.array([state.mean for state in states]).reshape(-1, n, K, delays)
    mean = np.take_along_axis(means, best[:, None, :, None], axis=3)[:, :, :, 0].transpose(0, 2, 1)
    return MostLikelyByStart(mean, bank.delays[best], np.isfinite(likely.max(axis=2)))


def start_spread(
    bank: OnlineBank, states: Sequence[BankState], others: MostLikelyByStart
) -> StartSpread:
    """Return the uncertainty due to the start and to the grid of delays.

    It follows from the differences between other starts, ``others``, and the declared start, whose
    bank and states are ``bank`` and ``states``.
    """
    likely = np.array([np.where(state.sound, state.log_likelihood, -np.inf) for state in states])
    best, rows = likely.argmax(axis=1), np.arange(len(states))
    low, high = np.maximum(best - 1, 0), np.minimum(best + 1, len(bank.delays) - 1)
    means = np.array([state.mean for state in states])
    delay_difference = (bank.delays[high] - bank.delays[low])[:, None]
    slope = (means[rows, :, high] - means[rows, :, low]) / delay_difference
    # The delay is distributed uniformly over one step of the grid.
    step = float(np.diff(bank.delays).mean())
    differences = others.mean - means[rows, :, best][:, None]
    start_variance = _median_variance(differences, others.sound[:, :, None])
    return StartSpread(
        np.sqrt(start_variance + np.square(slope) * step**2 / 12.0),
        np.sqrt(_median_variance(others.delay - bank.delays[best][:, None], others.sound)),
        np.where(others.sound[:, :, None], differences, 0.0),
    )


def spread_covariance(std: np.ndarray, differences: np.ndarray) -> np.ndarray:
    """Return the covariance ``(n, n)`` with the standard deviations ``std (n,)`` and the
    correlations of the ``differences (K, n)`` of one row.
    """
    products = differences.T @ differences
    norms = np.sqrt(np.diagonal(products))
    scale = np.divide(std, norms, out=np.zeros_like(std), where=norms > 0)
    covariance = scale[:, None] * products * scale
    np.fill_diagonal(covariance, np.square(std))
    return covariance


def _median_variance(differences: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return the median over the starts (second axis) of squares; a diverged start is infinite."""
    return np.median(np.where(sound, np.square(differences), np.inf), axis=1) / MEDIAN_SQUARE
