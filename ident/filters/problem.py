"""Problem of a filter (record, System, start, covariance), its history, and its Estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, FilterHistory, Outcome
from sim.declaration.effect import ParameterSet
from sim.declaration.model import System
from sim.errors import ModelError
from sim.propagation import Drive, Grid, drive_from_record, make_grid
from sim.record import Record

# ---- Problem of a filter

PRIOR_SHARE = 0.25  # prior standard deviation of a parameter over its starting value


@dataclass(frozen=True, eq=False)
class FilterProblem:
    """Problem of a filter: a record and a System, with states and free parameters estimated.

    Attributes
    ----------
    system : the System.
    grid : nodes and sub-steps of the integration.
    drive : inputs at the vehicle on this grid.
    time : ``(N,)``, s.
    z : ``(m, N)`` measured outputs.
    valid : ``(m, N)`` False where a sample is missing.
    p : all parameters.
    free : positions of the free parameters among ``p``.
    names : names of the n estimated quantities: the states, then the free parameters.
    start : ``(n,)`` starting mean.
    covariance : ``(n, n)`` at the start.
    density : ``(n,)`` spectral density of the process noise on each quantity.
    variance : ``(m,)`` variance of the measurement noise.
    """

    system: System
    grid: Grid
    drive: Drive
    time: np.ndarray
    z: np.ndarray
    valid: np.ndarray
    p: list[float]
    free: list[int]
    names: tuple[str, ...]
    start: np.ndarray
    covariance: np.ndarray
    density: np.ndarray
    variance: np.ndarray

    @property
    def walking(self) -> bool:
        """Whether a free parameter is a random walk."""
        return bool(np.any(self.density[len(self.system.states) :]))


def filter_problem(record: Record, system: System, max_step: float) -> FilterProblem:
    """Return the problem of a filter for a record and a System.

    ``max_step`` is the longest sub-step, s; infinite takes the longest sampling interval.

    Raises
    ------
    ModelError : where record and System have no output in common, a noise level is not declared, a
        free parameter or state has no prior standard deviation, or an effect cannot run on line.
    """
    present = [name for name in system.output_names if name in record.output_names]
    if not present:
        raise ModelError(
            f"the record has none of the outputs {', '.join(system.output_names)}",
            where=record.name,
            remedy="name the columns, or map them with --channels",
        )
    if system.sensor_stages:
        raise ModelError(
            f"effect {system.sensor_stages[0]} has a memory on the sensor path",
            where="filter",
            remedy="compile the model with online=True, or use a whole-record fit (output-error)",
        )
    z, valid = record.output_array(system.output_names)
    p = system.parameters.values().tolist()
    density_of_states, variance = system.noise(p)
    variance = [
        value if name in present else 1.0
        for value, name in zip(variance, system.output_names, strict=True)
    ]
    refuse_undeclared_noise(system, variance)
    free_names = system.parameters.free_names
    random_walk = [system.declared_noise.process_density.get(name, 0.0) for name in free_names]
    grid = make_grid(
        record.time, max_step if math.isfinite(max_step) else float(np.diff(record.time).max())
    )
    return FilterProblem(
        system,
        grid,
        drive_from_record(
            system, p, record.input_array(system.input_names), record.time, record.hold, grid
        ),
        record.time,
        z,
        valid,
        p,
        [system.parameters.index(name) for name in free_names],
        (*system.state_names, *free_names),
        np.concatenate([system.initial.values(), system.parameters.values(free_names)]),
        prior_covariance(system),
        np.array([*density_of_states, *random_walk], dtype=float),
        np.array(variance, dtype=float),
    )


def refuse_undeclared_noise(system: System, variance: Sequence[float]) -> None:
    """Raise ModelError where the measurement noise ``variance (m,)`` is not declared."""
    for name, value in zip(system.output_names, variance, strict=True):
        if not (math.isfinite(value) and value > 0):
            raise ModelError(
                "its measurement noise is not declared",
                where=f"output {name}",
                remedy="give its standard deviation",
            )


def prior_covariance(system: System) -> np.ndarray:
    """Return the prior covariance of the states and free parameters; see `prior_std`."""
    std = [prior_std(system, name, state=True) for name in system.state_names]
    std += [prior_std(system, name, state=False) for name in system.parameters.free_names]
    return np.diag(np.square(std))


def with_free(p: Sequence[float], free: Sequence[int], values: Sequence[object]) -> list:
    """Return all parameters ``p`` with those at the positions ``free`` replaced by ``values``."""
    parameters: list = list(p)
    for index, value in zip(free, values, strict=True):
        parameters[index] = value
    return parameters


def prior_std(system: System, name: str, *, state: bool) -> float:
    """Return the prior standard deviation of a state or free parameter; 0 for a fixed state.

    Raises
    ------
    ModelError : where none is declared.
    """
    item = system.initial[name] if state else system.parameters[name]
    if state and not item.free:
        return 0.0
    if not math.isfinite(item.prior_std):
        kind = "initial state" if state else "parameter"
        raise ModelError(
            f"{kind} without a prior standard deviation",
            where=name,
            remedy="a filter needs one; give it, or use output-error",
        )
    return item.prior_std


def proportional_priors(parameters: ParameterSet, engineering: Mapping[str, float]) -> ParameterSet:
    """Return the parameters with prior standard deviations of all free ones: an engineering value,
    or else a quarter of the starting value.

    This is the rule of NASA TM-101722: P0 = (x0/4)^2, and a bound by engineering judgement for
    states that start at or near zero.

    Parameters
    ----------
    engineering : parameter -> standard deviation; those of fixed parameters are ignored.

    Raises
    ------
    ModelError : where a free parameter starts at zero and has no engineering value.
    """
    priors = {}
    for item in parameters:
        if not item.free:
            continue
        priors[item.name] = engineering.get(item.name, PRIOR_SHARE * abs(item.value))
        if not priors[item.name] > 0:
            raise ModelError(
                "it starts at zero, so that no prior follows from the start",
                where=f"parameter {item.name}",
                remedy="give its standard deviation",
            )
    return parameters.with_prior(priors)


# ---- Histories of a filter, sample by sample, and its Estimate

LOG_TWO_PI = float(np.log(2.0 * np.pi))


def breakdown(
    mean: np.ndarray, covariance: np.ndarray, *further: np.ndarray | float
) -> Outcome | None:
    """Return the outcome of a filter that broke down, else None.

    It is ``DIVERGED`` where a number in the mean ``(n,)``, the covariance ``(n, n)`` or ``further``
    is not finite, and ``INDEFINITE`` where a variance is negative.
    """
    numbers = (mean, covariance, *further)
    # Quick sufficient test: if the sum of squares is below the limit (> 1), so is every number.
    # Only otherwise compare the absolute values. A NaN fails both tests.
    if not sum(np.vdot(v, v) for v in numbers) < LARGEST_NUMBER and not all(
        np.abs(v).max(initial=0.0) < LARGEST_NUMBER for v in numbers
    ):
        return Outcome.DIVERGED
    return Outcome.INDEFINITE if covariance.diagonal().min() < 0.0 else None


class FilterBuffers(NamedTuple):
    """Results of one pass, with the samples as the first axis.

    Attributes
    ----------
    mean, covariance : ``(N, n)`` and ``(N, n, n)`` after each update.
    predicted_mean, predicted_covariance : ``(N, n)`` and ``(N, n, n)`` before each update.
    transition : ``(N, n, n)`` fundamental matrix from the sample before.
    innovation, S : ``(N, m)`` innovation, and its covariance ``(N, m, m)``.
    sensitivity : ``(N, m, n)`` Jacobian of the outputs.
    outputs : ``(N, m)`` predicted outputs.
    """

    mean: np.ndarray
    covariance: np.ndarray
    predicted_mean: np.ndarray
    predicted_covariance: np.ndarray
    transition: np.ndarray
    innovation: np.ndarray
    S: np.ndarray
    sensitivity: np.ndarray
    outputs: np.ndarray


def empty_buffers(problem: FilterProblem) -> FilterBuffers:
    """Return the arrays for a pass. Transitions are the identity; all other arrays are
    uninitialised.
    """
    n, (m, N) = len(problem.names), problem.valid.shape
    shapes = (N, n), (N, n, n), (N, n), (N, n, n), (N, n, n), (N, m), (N, m, m), (N, m, n), (N, m)
    buffers = FilterBuffers(*map(np.empty, shapes))
    buffers.transition[:] = np.eye(n)
    return buffers


class HistoryKeeper:
    """History of one pass of a filter, stored sample by sample.

    Where the filter broke down, all later samples get the last finite values, so that a history has
    finite numbers only.
    """

    def __init__(self, problem: FilterProblem) -> None:
        N, m = len(problem.time), len(problem.variance)
        self._problem, self._last = problem, -1
        self._stored = empty_buffers(problem)
        self._stored.S[:] = np.eye(m)
        for array in (self._stored.innovation, self._stored.sensitivity, self._stored.outputs):
            array[:] = 0.0
        self._valid = np.zeros((m, N), dtype=bool)
        self._log_likelihood, self._nis = np.zeros(N), np.zeros(N)
        self._degrees = np.zeros(N, dtype=int)

    def store_prediction(
        self, k: int, mean: np.ndarray, covariance: np.ndarray, transition: np.ndarray
    ) -> None:
        """Store the prediction before the update at sample ``k``."""
        stored = self._stored
        stored.predicted_mean[k], stored.predicted_covariance[k] = mean, covariance
        stored.transition[k] = transition

    def transition(self, k: int) -> np.ndarray:
        """Return the transition stored for sample ``k``."""
        return self._stored.transition[k]

    def store_outputs(self, k: int, y: np.ndarray) -> None:
        """Store the predicted outputs ``y (m,)`` at sample ``k``, also of channels without a
        sample.
        """
        self._stored.outputs[k] = y

    def store_innovation(
        self,
        k: int,
        rows: np.ndarray,
        nu: np.ndarray,
        S: np.ndarray,
        H: np.ndarray,
        log_likelihood: float,
        nis: float,
    ) -> None:
        """Store the innovation ``nu`` of the channels ``rows`` at sample ``k``, its covariance
        ``S``, the output Jacobian ``H``, and its log likelihood and normalised square.
        """
        self._stored.innovation[k, rows], self._stored.sensitivity[k, rows] = nu, H
        self._stored.S[k][np.ix_(rows, rows)] = S
        self._valid[rows, k] = True
        self._log_likelihood[k], self._nis[k], self._degrees[k] = log_likelihood, nis, len(rows)

    def store_update(self, k: int, mean: np.ndarray, covariance: np.ndarray) -> None:
        """Store the mean and covariance after the update at sample ``k``. They must be finite."""
        self._stored.mean[k], self._stored.covariance[k], self._last = mean, covariance, k

    def estimate(self, method: str, outcome: Outcome) -> Estimate:
        """Return the estimate at the last finite sample, with the history."""
        problem, last, stored = self._problem, self._last, self._stored
        mean = stored.mean[last] if last >= 0 else problem.start
        covariance = stored.covariance[last] if last >= 0 else problem.covariance
        later = slice(last + 1, None)
        stored.mean[later] = stored.predicted_mean[later] = mean
        stored.covariance[later] = stored.predicted_covariance[later] = covariance
        stored.transition[later], stored.S[later] = np.eye(len(mean)), np.eye(len(self._valid))
        stored.innovation[later] = stored.sensitivity[later] = 0.0
        stored.outputs[later] = stored.outputs[last] if last >= 0 else 0.0
        self._valid[:, later] = False
        self._log_likelihood[later] = self._nis[later] = self._degrees[later] = 0
        samples = self._valid, self._log_likelihood, self._nis, self._degrees
        estimate = estimate_with_history(problem, method, outcome, stored, *samples)
        if outcome is Outcome.CONVERGED:
            return estimate
        broken = problem.time[min(last + 1, len(problem.time) - 1)]
        return replace(estimate, message=f"at {broken:g} s")


def estimate_from_buffers(
    problem: FilterProblem, buffers: FilterBuffers, method: str
) -> Estimate | None:
    """Return the estimate of a complete pass from its buffers; None where a number is not finite or
    a variance is negative.
    """
    variance = np.diagonal(buffers.covariance, axis1=1, axis2=2)
    finite = all(
        array.max(initial=0.0) < LARGEST_NUMBER and array.min(initial=0.0) > -LARGEST_NUMBER
        for array in buffers
    )
    if not finite or variance.min(initial=0.0) < 0.0:
        return None
    try:
        root = np.linalg.cholesky(buffers.S)
    except np.linalg.LinAlgError:
        return None
    # A missing channel has a zero innovation and a one in S, which change neither nis nor the
    # determinant.
    nis = np.square(np.linalg.solve(root, buffers.innovation[:, :, None])[:, :, 0]).sum(axis=1)
    if not np.all(nis < LARGEST_NUMBER):
        return None
    degrees = np.count_nonzero(problem.valid, axis=0)
    log_likelihood = -0.5 * (nis + degrees * LOG_TWO_PI) - np.log(
        np.diagonal(root, axis1=1, axis2=2)
    ).sum(axis=1)
    for P in (buffers.predicted_covariance, buffers.covariance):
        np.add(P, P.transpose(0, 2, 1), out=P)
        np.multiply(P, 0.5, out=P)
    return estimate_with_history(
        problem,
        method,
        Outcome.CONVERGED,
        buffers,
        problem.valid.copy(),
        log_likelihood,
        nis,
        degrees,
    )


def estimate_with_history(
    problem: FilterProblem,
    method: str,
    outcome: Outcome,
    buffers: FilterBuffers,
    valid: np.ndarray,
    log_likelihood: np.ndarray,
    nis: np.ndarray,
    degrees: np.ndarray,
) -> Estimate:
    """Return the estimate of the free parameters after the last sample of a pass, with its history.

    ``valid (m, N)``, ``log_likelihood``, ``nis`` and ``degrees (N,)`` are those of a
    `FilterHistory`.
    """
    variance, n_x = np.diagonal(buffers.covariance, axis1=1, axis2=2), len(problem.system.states)
    history = FilterHistory(
        problem.time,
        problem.names,
        buffers.mean.T.copy(),
        np.sqrt(np.maximum(variance.T, 0.0)),
        buffers.innovation.T.copy(),
        np.sqrt(np.diagonal(buffers.S, axis1=1, axis2=2).T),
        valid,
        log_likelihood,
        nis,
        degrees,
        buffers.predicted_mean.T.copy(),
        buffers.predicted_covariance,
        buffers.covariance,
        buffers.transition,
        buffers.sensitivity,
        buffers.S,
    )
    names = problem.names[n_x:]
    return Estimate(
        method,
        names,
        tuple(problem.system.parameters[name].unit for name in names),
        buffers.mean[-1, n_x:].copy(),
        buffers.covariance[-1, n_x:, n_x:].copy(),
        outcome,
        float(log_likelihood.sum()),
        problem.system.output_names,
        np.sqrt(problem.variance),
        (buffers.outputs.T.copy(),),
        history,
    )
