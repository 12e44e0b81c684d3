"""Output-error fit: maximum likelihood without process noise, over one or several whole records.

Levenberg-Marquardt on the defect-corrected residual, each channel's noise variance concentrated out
(Maine and Iliff, NASA RP-1138; Jategaonkar, Flight Vehicle System Identification, ch. 4). Parameters are
shared by all records; initial states and the parameters named local belong to one record each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.colour import corrected_covariance
from ident.estimate import Estimate, Outcome
from ident.information import conditional_scale, inverse_information
from ident.keeping import LARGEST
from ident.whole_record import Linearisation, RecordProblem, guess_states, linearise, record_problem
from sim.errors import ModelError
from sim.record import Record
from sim.system import System


@dataclass(frozen=True)
class FitSettings:
    """How a whole-record fit runs.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    iterations : limit of accepted and rejected steps together.
    tolerance : the fit has settled when a step moves no parameter by more than this share of its sigma.
    use_priors : add the Gaussian priors of parameters and initial states to the cost.
    coloured : correct the covariance for residuals that are not white.
    """

    max_step: float = 0.01
    iterations: int = 60
    tolerance: float = 1e-3
    use_priors: bool = False
    coloured: bool = True


@dataclass(frozen=True, eq=False)
class _Point:
    theta: np.ndarray
    guesses: list[np.ndarray]
    lines: list[Linearisation]
    residuals: list[np.ndarray]
    variance: np.ndarray
    cost: float


def fit_output_error(records: Sequence[Record], system: System, settings: FitSettings | None = None) -> Estimate:
    """Fit the free parameters of a System to records by whole-record simulation.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : not compiled on line; bounds, and with ``use_priors`` priors, from its declaration.

    Returns
    -------
    Estimate of the shared free parameters; biases and initial states are nuisances, projected out of the covariance.
    Outcome ``NOT_IDENTIFIABLE`` when a direction of the parameters has no influence, ``DIVERGED`` when no finite
    cost was found, ``MAX_ITERATIONS`` when it had not settled.

    Raises
    ------
    ModelError : a record without any of the outputs, or nothing to estimate.
    """
    settings = settings or FitSettings()
    fit = _Fit(records, system, settings)
    point = fit.evaluate(fit.start, fit.first_guesses())
    if point is None:
        return fit.estimate(fit.start, None, Outcome.DIVERGED, 0)
    damping, outcome, done = 1e-4, Outcome.MAX_ITERATIONS, 0
    while done < settings.iterations:
        done += 1
        normal, gradient = fit.normal_equations(point)
        scale, moving = fit.scale_and_moving(point.theta, normal, gradient)
        scaled, slope = normal * np.outer(scale, scale), scale * gradient
        step = scale * _damped_solution(scaled, slope, damping, moving)
        trial_theta = np.clip(point.theta + step, fit.low, fit.high)
        guesses = [np.array(line.states + line.by_state @ fit.of_record(trial_theta - point.theta, r)) for r, line in enumerate(point.lines)]
        trial = fit.evaluate(trial_theta, guesses)
        if trial is not None and trial.cost <= point.cost + 1e-9 * abs(point.cost):
            moved = np.max(np.abs(trial.theta - point.theta) / scale)
            point, damping = trial, max(damping / 10.0, 1e-12)
            if moved < settings.tolerance:
                outcome = Outcome.CONVERGED
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                # No descent is left: at the optimum if the undamped step says so too.
                undamped = np.max(np.abs(_damped_solution(scaled, slope, 1e-12, moving)), initial=0.0)
                outcome = Outcome.CONVERGED if undamped < 10.0 * settings.tolerance else Outcome.MAX_ITERATIONS
                break
    return fit.estimate(point.theta, fit.joined_up(point), outcome, done)


def _damped_solution(scaled: np.ndarray, slope: np.ndarray, damping: float, moving: np.ndarray) -> np.ndarray:
    """Step in scaled units; what rests at a bound, or has no influence, stays."""
    out = np.zeros(len(slope))
    at = np.flatnonzero(moving)
    out[at] = np.linalg.solve(scaled[np.ix_(at, at)] + damping * np.eye(len(at)), slope[at])
    return out


class _Fit:
    """Layout of the unknowns: shared parameters, then for each record its local ones and initial states."""

    def __init__(self, records: Sequence[Record], system: System, settings: FitSettings) -> None:
        self.records, self.system, self.settings = list(records), system, settings
        parameters, initial = system.parameters, system.initial
        for record in self.records:
            if not any(name in record.output_names for name in system.output_names):
                raise ModelError(f"it has none of the outputs {', '.join(system.output_names)}", where=record.name, remedy="name or map its columns")
        recorded = {name for record in self.records for name in record.output_names}
        free = [n for n in parameters.free_names if not (n.startswith("bias_") and n.removeprefix("bias_") not in recorded)]
        self.shared = [name for name in free if not name.startswith("bias_")]
        self.local = [name for name in free if name.startswith("bias_")]
        if not self.shared:
            raise ModelError("no parameter is free", where=f"model with {', '.join(parameters.names)}", remedy="release at least one")
        self.starts = [i for i, item in enumerate(initial) if item.free]
        self.order = [parameters.index(name) for name in [*self.shared, *self.local]]
        self.problems: list[RecordProblem] = [record_problem(r, system, settings.max_step, self.order, self.starts) for r in self.records]
        own = [parameters[name] for name in self.local] + [initial.items[i] for i in self.starts]
        items = [parameters[name] for name in self.shared] + own * len(self.records)
        self.low, self.high = np.array([item.bounds[0] for item in items]), np.array([item.bounds[1] for item in items])
        self.start = np.array([item.value for item in items])
        self._seed_initial_states(len(own))
        self.prior = self.start.copy()
        self.prior_weight = np.array([item.prior_std**-2 for item in items]) if settings.use_priors else np.zeros(len(items))
        size = np.array([max(np.max(np.abs(problem.z[i]), initial=0.0) for problem in self.problems) for i in range(len(system.outputs))])
        self.smallest = np.maximum(1e-14 * size, 1e-30) ** 2  # rounding: exact data must not weigh infinitely
        self.used = np.array([any(np.any(problem.valid[i]) for problem in self.problems) for i in range(len(system.outputs))])

    def _seed_initial_states(self, own: int) -> None:
        for r, record in enumerate(self.records):
            for c, i in enumerate(self.starts):
                name = self.system.state_names[i]
                if name in record.output_names and not self.settings.use_priors:
                    channel = record[name]
                    at = len(self.shared) + r * own + len(self.local) + c
                    self.start[at] = np.clip(channel.values[channel.valid][0], self.low[at], self.high[at])

    def columns(self, r: int) -> np.ndarray:
        """Positions in theta of the columns that record ``r`` sees."""
        own = len(self.local) + len(self.starts)
        return np.concatenate([np.arange(len(self.shared)), len(self.shared) + r * own + np.arange(own)])

    def of_record(self, theta: np.ndarray, r: int) -> np.ndarray:
        return theta[self.columns(r)]

    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]:
        """All parameters and the initial state of record ``r``."""
        mine = self.of_record(theta, r)
        p, x0 = self.system.parameters.values(), self.system.initial.values()
        p[self.order] = mine[: len(self.order)]
        x0[self.starts] = mine[len(self.order) :]
        return p, x0

    def first_guesses(self) -> list[np.ndarray]:
        return [guess_states(problem, *self.split(self.start, r)) for r, problem in enumerate(self.problems)]

    def evaluate(self, theta: np.ndarray, guesses: list[np.ndarray]) -> _Point | None:
        lines, residuals = [], []
        with np.errstate(all="ignore"):
            for r, problem in enumerate(self.problems):
                p, x0 = self.split(theta, r)
                line = linearise(problem, p, x0, guesses[r])
                if not (np.all(np.abs(line.y) < LARGEST) and np.all(np.abs(line.jacobian) < LARGEST)):
                    return None
                lines.append(line)
                residuals.append(np.where(problem.valid, problem.z - line.y, 0.0))
        counts = sum(problem.valid.sum(axis=1) for problem in self.problems)
        squares = sum((residual**2).sum(axis=1) for residual in residuals)
        variance = np.where(self.used, np.maximum(squares / np.maximum(counts, 1), self.smallest), 1.0)
        prior = float(self.prior_weight @ (theta - self.prior) ** 2)
        cost = 0.5 * float(np.sum(np.where(self.used, counts * np.log(variance), 0.0)) + prior)
        return _Point(theta, guesses, lines, residuals, variance, cost)

    def normal_equations(self, point: _Point) -> tuple[np.ndarray, np.ndarray]:
        normal, gradient = np.diag(self.prior_weight).copy(), self.prior_weight * (self.prior - point.theta)
        for r, (problem, line, residual) in enumerate(zip(self.problems, point.lines, point.residuals, strict=True)):
            at = self.columns(r)
            weighted = np.where(problem.valid, 1.0 / point.variance[:, None], 0.0)
            J = line.jacobian.reshape(-1, len(at))
            normal[np.ix_(at, at)] += J.T @ (weighted.reshape(-1, 1) * J)
            gradient[at] += J.T @ (weighted * residual).ravel()
        return normal, gradient

    def scale_and_moving(self, theta: np.ndarray, normal: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Conditional sigma of each unknown (one without influence: its size), and which of them a step may move."""
        pressed = ((theta <= self.low) & (gradient < 0)) | ((theta >= self.high) & (gradient > 0))
        return conditional_scale(normal, theta), (np.diag(normal) > 0) & ~pressed

    def joined_up(self, point: _Point) -> _Point:
        """The same parameters with a trajectory that obeys the equations to rounding: what the last step left is squared away."""
        for _ in range(3):
            gap = max(np.max(np.abs(line.states - guess), initial=0.0) for line, guess in zip(point.lines, point.guesses, strict=True))
            size = max(np.max(np.abs(line.states), initial=0.0) for line in point.lines)
            again = self.evaluate(point.theta, [line.states for line in point.lines]) if gap > 1e-13 * size else None
            if again is None:
                break
            point = again
        return point

    def estimate(self, theta: np.ndarray, point: _Point | None, outcome: Outcome, iterations: int) -> Estimate:
        n = len(self.shared)
        units = tuple(self.system.parameters[name].unit for name in self.shared)
        if point is None:
            blank = tuple(np.zeros_like(problem.z) for problem in self.problems)
            wide = np.diag(np.maximum(1.0, theta[:n] ** 2))
            return Estimate(
                "output-error", tuple(self.shared), units, theta[:n], wide, outcome, -np.inf, self.system.output_names, np.ones(len(self.used)), blank
            )
        normal, _ = self.normal_equations(point)
        inverse, determined = inverse_information(normal, theta)
        if not determined:
            outcome = Outcome.NOT_IDENTIFIABLE
        covariance = inverse
        if self.settings.coloured:
            parts = [(self.columns(r), line.jacobian, point.residuals[r], self.problems[r].valid) for r, line in enumerate(point.lines)]
            covariance = corrected_covariance(inverse, parts, point.variance)
        counts = sum(problem.valid.sum() for problem in self.problems)
        log_likelihood = -point.cost - 0.5 * float(counts) * (1.0 + np.log(2.0 * np.pi))
        return Estimate(
            "output-error",
            tuple(self.shared),
            units,
            theta[:n].copy(),
            covariance[:n, :n],
            outcome,
            log_likelihood,
            self.system.output_names,
            np.sqrt(point.variance),
            tuple(line.y for line in point.lines),
            iterations=iterations,
        )
