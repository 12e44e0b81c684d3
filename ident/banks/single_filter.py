"""The own kernel for one filter with its whole history: by its table or as a bank of one, equal to filterpy's to rounding."""

from __future__ import annotations

import numpy as np

from ident.banks.any_equations import values_and_jacobians
from ident.banks.one_pass import run_pass, worth
from ident.banks.runs import BankRuns, BankTrace, empty_trace
from ident.estimate import Estimate, FilterHistory, Outcome
from ident.filters.ekf import FilterSettings, filter_by_filterpy, filter_by_table
from ident.filters.problem import FilterProblem, filter_problem, with_free
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.record import Record


def filter_alone(record: Record, system: System, settings: FilterSettings | None = None, about: np.ndarray | None = None) -> Estimate:
    """One pass of one filter by the own kernel, with everything a smoother or a report asks for.

    ``about (n, N)`` is a trajectory at the samples to linearise about, instead of the filter's own estimate.

    Raises
    ------
    ModelError : as for ``run_bank``.
    """
    settings = settings or FilterSettings()
    return filter_batched(filter_problem(record, system, settings.max_step), settings, about=about)


def filter_batched(problem: FilterProblem, settings: FilterSettings, start: np.ndarray | None = None, about: np.ndarray | None = None) -> Estimate:
    """``filter_by_filterpy`` by the own kernel: by the table of the equations, else by a bank of one run. Arguments as there.

    A filter that breaks down is left to ``filter_by_filterpy``, which says how.
    """
    by_table = filter_by_table(problem, settings, start, about)
    if by_table is not None:
        return by_table
    first = problem.start if start is None else start
    runs = BankRuns(list(problem.p), problem.drive, problem.z[:, :, None], np.asarray(first, dtype=float).reshape(-1, 1).copy())
    system, trace = problem.system, empty_trace(problem, 1)
    result = run_pass(problem, settings, runs, False, None if about is None else about[:, :, None], trace)
    if not result.sound[0]:
        return filter_by_filterpy(problem, settings, start, about)
    history, fitted = _history(problem, trace, about)
    n_x = len(system.states)
    names = problem.names[n_x:]
    return Estimate(
        "ekf",
        names,
        tuple(system.parameters[name].unit for name in names),
        result.mean[n_x:, 0].copy(),
        result.covariance[0, n_x:, n_x:].copy(),
        Outcome.CONVERGED,
        float(history.log_likelihood.sum()),
        system.output_names,
        np.sqrt(problem.variance),
        (fitted,),
        history,
    )


def _history(problem: FilterProblem, trace: BankTrace, about: np.ndarray | None) -> tuple[FilterHistory, np.ndarray]:
    """The history of a pass of one run, and the outputs ``(m, N)`` that the filter expected, also of channels without a sample."""
    system, N, n, n_x = problem.system, len(problem.time), len(problem.names), len(problem.system.states)
    mean, covariance = trace.mean[:, :, 0], trace.covariance[:, 0]
    HP, S, y = trace.HP[:, 0], trace.S[:, 0], trace.y[:, 0]
    # What the update took from the prediction, put back.
    gain = np.swapaxes(np.linalg.solve(S, HP), 1, 2)
    before, P_before = mean - (gain @ y[:, :, None])[:, :, 0], covariance + gain @ HP
    transition = np.array(np.broadcast_to(np.eye(n), (N, n, n)))
    transition[1:, :n_x] += trace.moved[1:, 0]
    at = problem.grid.sample
    point = before.T if about is None else about
    inputs = [row[at] for row in problem.drive.begin]
    outputs, slopes = values_and_jacobians(
        lambda a: system.h(problem.grid.edges[at], a[:n_x], inputs, with_free(problem.p, problem.free, a[n_x:])),
        point,
        (1j * COMPLEX_STEP) * np.eye(n)[:, :, None],
    )
    gained, squared = worth(np.concatenate([y[:, None, :, None], S[:, None]], axis=3), problem.valid)
    history = FilterHistory(
        problem.time,
        problem.names,
        mean.T.copy(),
        np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0)),
        y.T.copy(),
        np.sqrt(np.diagonal(S, axis1=1, axis2=2).T),
        problem.valid.copy(),
        gained[:, 0],
        squared[:, 0],
        np.count_nonzero(problem.valid, axis=0),
        before.T.copy(),
        P_before,
        covariance.copy(),
        transition,
        trace.H[:, 0].copy(),
        S.copy(),
    )
    return history, outputs + (slopes @ (before - point.T)[:, :, None])[:, :, 0].T
