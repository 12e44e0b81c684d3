"""Many extended Kalman filters in one batched pass: banks of delays, Monte-Carlo campaigns.

The same filter as `ident.filters.ekf`, with runs on a batch axis (`ident.banks.one_pass`); it agrees with filterpy's to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from ident.banks.one_pass import run_pass
from ident.banks.runs import BankHistory, BankPass, BankRuns
from ident.filters.ekf import SETTLED, FilterSettings
from ident.filters.problem import FilterProblem, filter_problem
from sim.declaration.model import System
from sim.errors import ModelError
from sim.propagation import drive_from_record
from sim.record import Record


@dataclass(frozen=True, eq=False)
class BankEstimate:
    """Final estimates of B filters.

    Attributes
    ----------
    names : states, then free parameters (n).
    mean : ``(n, B)``, covariance : ``(B, n, n)`` after the last sound sample.
    log_likelihood : ``(B,)``; minus infinity for a run that broke down.
    nis : ``(N, B)`` normalised innovation squared at each sample, zero where nothing was measured or a run broke down.
    sound : ``(B,)`` False where a run broke down.
    iterations : ``(B,)`` passes over the data of each run.
    innovation, innovation_std : ``(m, N, B)``, kept when asked for; zero and one where a sample is missing.
    history, history_std : ``(n, N, B)`` means and standard deviations after each update, kept when asked for.
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
    held: Mapping[str, np.ndarray] | None = None,
    start: np.ndarray | None = None,
    covariance: np.ndarray | None = None,
    keep: bool = False,
) -> BankEstimate:
    """Run B filters over one time base.

    Parameters
    ----------
    record : time, inputs, and the validity of the outputs, shared by all runs.
    system : compiled with ``online=True``.
    settings : as for ``run_ekf``. With several passes each run stops by itself as ``run_ekf`` does: settled or
        broken down, it takes no further part, and the bank ends when no run is left.
    z : outputs of each run, ``(m, N, B)``; the record's own for all when None.
    held : values of held parameters by name, ``(B,)`` each, e.g. ``{"input-delay.delay": delays}``.
    start : starting mean of states and free parameters, ``(n,)`` or ``(n, B)``; the System's when None.
    covariance : at the start, ``(B, n, n)``, for a single pass; the System's priors for all when None.
    keep : also return histories of means and innovations.

    Raises
    ------
    ModelError : as for ``run_ekf``; a parameter given in ``held`` that is free; numbers of runs that differ; a covariance of each
        run with several passes.
    """
    settings = settings or FilterSettings()
    problem, runs = bank_runs(record, system, settings, z=z, held=held, start=start)
    n_x, count = len(system.states), runs.start.shape[1]
    if covariance is not None:
        if settings.passes > 1 or covariance.shape != (count, *problem.covariance.shape):
            raise ModelError("a covariance for each run is for one pass of as many runs", where="bank", remedy="call it once for each pass")
        problem = replace(problem, covariance=covariance)

    # Runs with data of their own are a campaign's: hundreds, each of which must not depend on the others.
    filtered = partial(run_pass, problem, settings, in_rows=z is not None)
    result, iterations = filtered(runs, keep), np.ones(count, dtype=int)
    active = np.flatnonzero(result.sound)
    for done in range(1, settings.passes):
        if active.size == 0:
            break
        start_again = np.concatenate([runs.start[:n_x], result.mean[n_x:]])
        again = filtered(BankRuns(runs.p, runs.drive, runs.z, start_again).only(active), keep)
        std = np.sqrt(np.maximum(np.diagonal(result.covariance[active], axis1=1, axis2=2).T[n_x:], np.finfo(float).tiny))
        moved = np.max(np.abs(again.mean[n_x:] - result.mean[n_x:, active]) / std, axis=0, initial=0.0)
        result, iterations[active] = _merged(result, again, active), done + 1
        active = active[again.sound & (moved >= SETTLED)]
    return bank_estimate(problem, result, iterations, sound=result.sound)


def bank_estimate(problem: FilterProblem, result: BankPass, iterations: np.ndarray, *, sound: np.ndarray) -> BankEstimate:
    """A pass as an estimate; a run that is not ``sound`` has a likelihood of zero."""
    kept = result.history
    log_likelihood = np.where(sound, result.log_likelihood, -np.inf)
    estimate = (problem.names, result.mean, result.covariance, log_likelihood, result.nis, sound, iterations)
    return BankEstimate(*estimate) if kept is None else BankEstimate(*estimate, kept.innovation, kept.innovation_std, kept.mean, kept.std)


def bank_runs(
    record: Record,
    system: System,
    settings: FilterSettings,
    *,
    z: np.ndarray | None = None,
    held: Mapping[str, np.ndarray] | None = None,
    start: np.ndarray | None = None,
) -> tuple[FilterProblem, BankRuns]:
    """What a bank filters, from the arguments of ``run_bank``."""
    problem = filter_problem(record, system, settings.max_step)
    n = len(problem.names)
    p: list = list(problem.p)
    for name, values in (held or {}).items():
        if system.parameters[name].free:
            raise ModelError("it is free", where=f"bank, {name}", remedy="hold it, or vary its start instead")
        p[system.parameters.index(name)] = np.atleast_1d(np.asarray(values, dtype=float))
    drive = problem.drive
    if held:
        drive = drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, problem.grid)
    z_runs = problem.z[:, :, None] if z is None else np.asarray(z, dtype=float)
    first = np.asarray(problem.start if start is None else start, dtype=float).reshape(n, -1)
    count = _number_of_runs({"z": z_runs.shape[2], "start": first.shape[1], **{name: np.size(values) for name, values in (held or {}).items()}})
    return problem, BankRuns(p, drive, z_runs, np.array(np.broadcast_to(first, (n, count))))


def _number_of_runs(counts: Mapping[str, int]) -> int:
    several = {count for count in counts.values() if count > 1}
    if len(several) > 1:
        listed = ", ".join(f"{name} has {count}" for name, count in counts.items())
        raise ModelError("the numbers of runs differ", where=f"bank: {listed}", remedy="give each the same number, or one for all")
    return several.pop() if several else 1


def _merged(old: BankPass, new: BankPass, at: np.ndarray) -> BankPass:
    """The old pass with the runs ``at`` replaced by those of the new one."""

    def put(whole: np.ndarray, part: np.ndarray, leading: bool = False) -> np.ndarray:
        out = whole.copy()
        out[at if leading else (..., at)] = part
        return out

    history = old.history
    if history is not None and new.history is not None:
        history = BankHistory(*(put(getattr(history, field.name), getattr(new.history, field.name)) for field in fields(BankHistory)))
    return BankPass(
        put(old.mean, new.mean),
        put(old.covariance, new.covariance, leading=True),
        put(old.log_likelihood, new.log_likelihood),
        put(old.nis, new.nis),
        put(old.sound, new.sound),
        history,
    )
