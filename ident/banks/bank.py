"""Banks of extended Kalman filters: one batched pass, and one filter with its history.

A bank runs B filters over one time base. The runs may differ in parameters, inputs, measurements
and starts. The filter is that of `ident.filters.ekf` with the runs on a batch axis. It agrees with
filterpy to rounding. A pass filters its samples in blocks (`ident.banks.block_kernels`), by a
table of coefficients where the equations are bilinear, and otherwise by calls of the equations.
Each block ends with a check for failed runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from ident.banks.block_kernels import (
    BankRuns,
    BankTrace,
    FilteredBlock,
    eliminate_channels,
    empty_trace,
    step_block_filter,
    table_block_filter,
    values_and_jacobians,
)
from ident.banks.row_kernel import (
    SAMPLES_PER_CHECK,
    BankHistory,
    BankPass,
    run_pass_in_rows,
)
from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.filters.ekf import SETTLED_SIGMAS, FilterSettings, filter_by_filterpy, filter_by_table
from ident.filters.problem import (
    FilterBuffers,
    FilterProblem,
    estimate_with_history,
    filter_problem,
    with_free,
)
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP
from sim.propagation import drive_from_record
from sim.record import Record

# ---- One pass of many extended Kalman filters over one time base, runs on a batch axis

LOG_TWO_PI = float(np.log(2.0 * np.pi))


def run_pass(
    problem: FilterProblem,
    settings: FilterSettings,
    runs: BankRuns,
    keep: bool,
    nominal: np.ndarray | None = None,
    trace: BankTrace | None = None,
    *,
    in_rows: bool = False,
) -> BankPass:
    """Return the result of one pass of B runs. A run that breaks down keeps the mean and covariance
    of its last finite sample.

    Parameters
    ----------
    keep : return the histories of means and innovations too.
    nominal : ``(n, N, B)`` trajectories about which the filters are linearised; None takes their
        means.
    trace : arrays that are filled for the smoother; None fills none.
    in_rows : use `ident.banks.row_kernel` where the equations have a table. It is faster for more
        than a hundred runs, and its results do not depend on the number of runs.
    """
    if in_rows and nominal is None and trace is None:
        result = run_pass_in_rows(problem, settings, runs, keep)
        if result is not None:
            return result
    (n, B), (m, N) = runs.start.shape, problem.valid.shape
    x, P = runs.start, np.array(np.broadcast_to(problem.covariance, (B, n, n)), order="C")
    last_x, last_P, sound = x, P, np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory.empty(n, m, N, B) if keep else None
    with np.errstate(all="ignore"):
        filter_next_block = table_block_filter(problem, settings, runs) or step_block_filter(
            problem, settings, runs
        )
        for first in range(0, N, SAMPLES_PER_CHECK):
            last = min(first + SAMPLES_PER_CHECK, N)
            block = filter_next_block(first, last, x, P, nominal, trace)
            x, P = block.mean[-1].T, block.covariance[-1]
            gains, block_nis = likelihood_and_nis(block.innovation, problem.valid[:, first:last])
            finite = sound_so_far(block, block_nis, sound)
            log_likelihood = log_likelihood + np.where(finite, gains, 0.0).sum(axis=0)
            nis[first:last] = np.where(finite, block_nis, 0.0)
            if trace is not None:
                trace.mean[first:last] = block.mean.transpose(0, 2, 1)
                trace.covariance[first:last] = block.covariance
            if history is not None:
                diagonals = (last_P, block.covariance, block.innovation[..., 1:])
                last_variance, variance, y_variance = (
                    np.diagonal(array, axis1=-2, axis2=-1) for array in diagonals
                )
                rows = block.mean, variance, block.innovation[..., 0], y_variance
                history.write(slice(first, last), *rows, finite, (last_x.T, last_variance))
            last_x, last_P, sound = *_last_sound(block, finite, last_x, last_P), finite[-1]
    # P is symmetric but for rounding, since each step mirrors the rows of the states.
    return BankPass(
        last_x, 0.5 * (last_P + np.swapaxes(last_P, 1, 2)), log_likelihood, nis, sound, history
    )


def likelihood_and_nis(innovation: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the log likelihood and the normalised innovation squared of K samples, ``(K, B)``
    each.

    ``innovation (K, B, m, 1 + m)`` is that of a `FilteredBlock`. ``valid (m, K)`` is False where a
    sample is missing.
    """
    rows = innovation.copy()
    variance = eliminate_channels(rows)
    nis = (rows[..., 0] ** 2 / variance).sum(axis=-1)
    channels = np.count_nonzero(valid, axis=0)[:, None]
    return -0.5 * (nis + np.log(variance).sum(axis=-1) + channels * LOG_TWO_PI), nis


def sound_so_far(done: FilteredBlock, nis: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return ``(K, B)``: True where a run is finite and without a negative variance up to this
    sample of a block. ``before (B,)`` is the same for the last sample before the block.
    """
    variance = np.diagonal(done.covariance, axis1=2, axis2=3)
    # A number that is not finite stays so: testing the last sample is enough. The sum of squares is
    # the fastest test, and a NaN fails the comparison.
    ends = [array.ravel() for array in (done.mean[-1], done.covariance[-1], nis)]
    squares = sum(np.vdot(array, array) for array in ends)
    if before.all() and squares < LARGEST_NUMBER**2 and variance.min() >= 0.0:
        return np.ones(nis.shape, dtype=bool)
    good = np.all(np.abs(done.mean) < LARGEST_NUMBER, axis=2) & np.all(
        np.abs(done.covariance) < LARGEST_NUMBER, axis=(2, 3)
    )
    good &= np.all(variance >= 0.0, axis=2) & (np.abs(nis) < LARGEST_NUMBER)
    return np.logical_and.accumulate(good, axis=0) & before


def _last_sound(
    block: FilteredBlock, finite: np.ndarray, x: np.ndarray, P: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean ``(n, B)`` and covariance ``(B, n, n)`` of each run after its last finite
    sample in a block. ``x`` and ``P`` are the mean and covariance before the block.
    """
    if finite[-1].all():
        return block.mean[-1].T, block.covariance[-1]
    last_x, last_P, count = x.copy(), P.copy(), np.count_nonzero(finite, axis=0)
    for run in np.flatnonzero(count):
        k = count[run] - 1
        last_x[:, run], last_P[run] = block.mean[k, run], block.covariance[k, run]
    return last_x, last_P


# ---- Many extended Kalman filters in one batched pass: banks of delays, Monte-Carlo campaigns


@dataclass(frozen=True, eq=False)
class BankEstimate:
    """Final estimates of B filters.

    Attributes
    ----------
    names : names of the n states and free parameters.
    mean : ``(n, B)`` after the last finite sample.
    covariance : ``(B, n, n)`` after the last finite sample.
    log_likelihood : ``(B,)`` log likelihood of each run; minus infinity for a run that broke down.
    nis : ``(N, B)`` normalised innovation squared at each sample, zero where nothing was measured
        or the run had broken down.
    sound : ``(B,)`` False where a run broke down.
    iterations : ``(B,)`` number of passes of each run.
    innovation, innovation_std : ``(m, N, B)``, zero and one where a sample is missing; None where
        histories are not kept.
    history, history_std : ``(n, N, B)`` means and standard deviations after each update; None where
        histories are not kept.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    iterations: np.ndarray
    innovation: np.ndarray | None = None
    innovation_std: np.ndarray | None = None
    history: np.ndarray | None = None
    history_std: np.ndarray | None = None

    @property
    def std(self) -> np.ndarray:
        """Standard deviations after the last sample, ``(n, B)``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2).T, 0.0))


def run_bank(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    z: np.ndarray | None = None,
    fixed_values: Mapping[str, np.ndarray] | None = None,
    start: np.ndarray | None = None,
    covariance: np.ndarray | None = None,
    keep: bool = False,
) -> BankEstimate:
    """Return the estimates of B filters over one time base.

    Parameters
    ----------
    record : time, inputs and validity of the outputs, which are the same for all runs.
    system : model compiled with ``online=True``.
    settings : as for ``run_ekf``. With several passes, each run ends as in ``run_ekf``: where it
        has converged or broken down.
    z : ``(m, N, B)`` outputs of each run; None takes those of the record for all runs.
    fixed_values : fixed parameter -> its values ``(B,)``, e.g. ``{"input-delay.delay": delays}``.
    start : ``(n,)`` or ``(n, B)`` starting mean of states and free parameters; None takes the
        starting values of the System.
    covariance : ``(B, n, n)`` at the start, for a single pass; None takes the priors of the System
        for all runs.
    keep : return the histories of means and innovations too.

    Raises
    ------
    ModelError : as for ``run_ekf``. Also where a parameter in ``fixed_values`` is free, numbers of
        runs differ, or a covariance of each run is given for several passes.
    """
    settings = settings or FilterSettings()
    problem, runs = bank_runs(record, system, settings, z=z, fixed_values=fixed_values, start=start)
    n_x, count = len(system.states), runs.start.shape[1]
    if covariance is not None:
        if settings.passes > 1 or covariance.shape != (count, *problem.covariance.shape):
            raise ModelError(
                "a covariance for each run needs one pass and as many covariances as runs",
                where="bank",
                remedy="call run_bank once for each pass",
            )
        problem = replace(problem, covariance=covariance)

    # Runs with their own data belong to a campaign of hundreds and must not depend on each other.
    filtered = partial(run_pass, problem, settings, in_rows=z is not None)
    result, iterations = filtered(runs, keep), np.ones(count, dtype=int)
    active = np.flatnonzero(result.sound)
    for passes_before in range(1, settings.passes):
        if active.size == 0:
            break
        next_start = np.concatenate([runs.start[:n_x], result.mean[n_x:]])
        next_pass = filtered(BankRuns(runs.p, runs.drive, runs.z, next_start).select(active), keep)
        std = np.sqrt(
            np.maximum(
                np.diagonal(result.covariance[active], axis1=1, axis2=2).T[n_x:],
                np.finfo(float).tiny,
            )
        )
        change = np.max(
            np.abs(next_pass.mean[n_x:] - result.mean[n_x:, active]) / std, axis=0, initial=0.0
        )
        result, iterations[active] = _merged(result, next_pass, active), passes_before + 1
        active = active[next_pass.sound & (change >= SETTLED_SIGMAS)]
    return bank_estimate(problem, result, iterations, sound=result.sound)


def bank_estimate(
    problem: FilterProblem, result: BankPass, iterations: np.ndarray, *, sound: np.ndarray
) -> BankEstimate:
    """Return the estimate from the result of a pass. A run that is not ``sound (B,)`` has zero
    likelihood.
    """
    history = result.history
    histories: tuple[np.ndarray, ...] = ()
    if history is not None:
        histories = history.innovation, history.innovation_std, history.mean, history.std
    return BankEstimate(
        problem.names,
        result.mean,
        result.covariance,
        np.where(sound, result.log_likelihood, -np.inf),
        result.nis,
        sound,
        iterations,
        *histories,
    )


def bank_runs(
    record: Record,
    system: System,
    settings: FilterSettings,
    *,
    z: np.ndarray | None = None,
    fixed_values: Mapping[str, np.ndarray] | None = None,
    start: np.ndarray | None = None,
) -> tuple[FilterProblem, BankRuns]:
    """Return the filter problem and the runs of a bank, from the arguments of ``run_bank``."""
    problem = filter_problem(record, system, settings.max_step)
    n = len(problem.names)
    p: list = list(problem.p)
    for name, values in (fixed_values or {}).items():
        if system.parameters[name].free:
            raise ModelError(
                "the parameter is free",
                where=f"bank, {name}",
                remedy="fix it, or vary its start instead",
            )
        p[system.parameters.index(name)] = np.atleast_1d(np.asarray(values, dtype=float))
    drive = problem.drive
    if fixed_values:
        drive = drive_from_record(
            system,
            p,
            record.input_array(system.input_names),
            record.time,
            record.hold,
            problem.grid,
        )
    z_runs = problem.z[:, :, None] if z is None else np.asarray(z, dtype=float)
    first = np.asarray(problem.start if start is None else start, dtype=float).reshape(n, -1)
    count = _number_of_runs(
        {
            "z": z_runs.shape[2],
            "start": first.shape[1],
            **{name: np.size(values) for name, values in (fixed_values or {}).items()},
        }
    )
    return problem, BankRuns(p, drive, z_runs, np.array(np.broadcast_to(first, (n, count))))


def _number_of_runs(counts: Mapping[str, int]) -> int:
    """Return the number of runs. ``counts`` maps each argument to the number of runs it has, which
    is 1 or common to all arguments.
    """
    several = {count for count in counts.values() if count > 1}
    if len(several) > 1:
        listed = ", ".join(f"{name} has {count}" for name, count in counts.items())
        raise ModelError(
            "the numbers of runs differ",
            where=f"bank: {listed}",
            remedy="give each the same number, or one for all",
        )
    return several.pop() if several else 1


def _merged(old: BankPass, new: BankPass, at: np.ndarray) -> BankPass:
    """Return the result ``old`` with the runs ``at`` replaced by those of ``new``."""

    def replaced(whole: np.ndarray, part: np.ndarray, leading: bool = False) -> np.ndarray:
        merged = whole.copy()
        merged[at if leading else (..., at)] = part
        return merged

    history = old.history
    if history is not None and new.history is not None:
        history = BankHistory(
            *(
                replaced(getattr(history, field.name), getattr(new.history, field.name))
                for field in fields(BankHistory)
            )
        )
    return BankPass(
        replaced(old.mean, new.mean),
        replaced(old.covariance, new.covariance, leading=True),
        replaced(old.log_likelihood, new.log_likelihood),
        replaced(old.nis, new.nis),
        replaced(old.sound, new.sound),
        history,
    )


# ---- The batched kernel for one filter with its whole history


def filter_alone(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    """Return the estimate of one run by the batched kernel, with its history.

    ``nominal (n, N)`` is the trajectory about which the filter is linearised; None takes its mean.

    Raises
    ------
    ModelError : as for ``run_bank``.
    """
    settings = settings or FilterSettings()
    return filter_batched(
        filter_problem(record, system, settings.max_step), settings, nominal=nominal
    )


def filter_batched(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    """Return the estimate of one pass by the batched kernel, with the arguments and results of
    `filter_by_filterpy`.

    Where the run breaks down, `filter_by_filterpy` repeats the pass and reports the cause.
    """
    by_table = filter_by_table(problem, settings, start, nominal)
    if by_table is not None:
        return by_table
    first = np.array(problem.start if start is None else start, dtype=float).reshape(-1, 1)
    runs = BankRuns(list(problem.p), problem.drive, problem.z[:, :, None], first)
    trace = empty_trace(problem, 1)
    result = run_pass(
        problem, settings, runs, False, None if nominal is None else nominal[:, :, None], trace
    )
    if not result.sound[0]:
        return filter_by_filterpy(problem, settings, start, nominal)
    estimate = _estimate_with_history(problem, trace, nominal)
    n_x = len(problem.system.states)
    covariance = result.covariance[0, n_x:, n_x:].copy()
    return replace(estimate, values=result.mean[n_x:, 0].copy(), covariance=covariance)


def _estimate_with_history(
    problem: FilterProblem, trace: BankTrace, nominal: np.ndarray | None
) -> Estimate:
    """Return the estimate of a pass of one run, with its history."""
    system, N, n = problem.system, len(problem.time), len(problem.names)
    n_x = len(problem.system.states)
    mean, covariance = trace.mean[:, :, 0], trace.covariance[:, 0]
    HP, S, y = trace.HP[:, 0], trace.S[:, 0], trace.y[:, 0]
    # The trace has no predictions: they follow from the updated means and covariances.
    gain = np.swapaxes(np.linalg.solve(S, HP), 1, 2)
    before, P_before = mean - (gain @ y[:, :, None])[:, :, 0], covariance + gain @ HP
    transition = np.array(np.broadcast_to(np.eye(n), (N, n, n)))
    transition[1:, :n_x] += trace.transition[1:, 0]
    at = problem.grid.sample
    point = before.T if nominal is None else nominal
    inputs = [row[at] for row in problem.drive.begin]
    outputs, jacobian = values_and_jacobians(
        lambda a: system.h(
            problem.grid.edges[at], a[:n_x], inputs, with_free(problem.p, problem.free, a[n_x:])
        ),
        point,
        (1j * COMPLEX_STEP) * np.eye(n)[:, :, None],
    )
    log_likelihood, nis = likelihood_and_nis(
        np.concatenate([y[:, None, :, None], S[:, None]], axis=3), problem.valid
    )
    outputs = outputs + (jacobian @ (before - point.T)[:, :, None])[:, :, 0].T
    sensitivity = trace.H[:, 0].copy()
    arrays = mean, covariance.copy(), before, P_before, transition, y, S.copy(), sensitivity
    return estimate_with_history(
        problem,
        "ekf",
        Outcome.CONVERGED,
        FilterBuffers(*arrays, outputs.T),
        problem.valid.copy(),
        log_likelihood[:, 0],
        nis[:, 0],
        np.count_nonzero(problem.valid, axis=0),
    )
