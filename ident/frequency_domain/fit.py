"""Output error in the frequency domain: complex residuals of the outputs' transforms, their noise levels concentrated out.

Minus the log likelihood, constants left out, is sum over outputs i and bands b of n_ib ln(mean |Y - Y_model|^2): transforms of noise are
complex Gaussian, independent from harmonic to harmonic. Unknown are the shared parameters and, of each record, x[0] - x[N].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.estimate import LARGEST, Outcome
from ident.frequency_domain.linear_model import linear_model
from ident.frequency_domain.noise_spectrum import levels
from ident.frequency_domain.response import Delay, response
from ident.frequency_domain.transform import TransformedRecord
from ident.statistics.information import LocalModel, add_normal_equations, local_model, unresolved
from sim.declaration.model import System

_STEEPEST = 1e8  # damping from which no descent is left
_WINDOW, _NOTHING = 8, 1e-3  # steps that gained less log likelihood than this together (0.04 sigmas) will gain no more
_ROUNDING = 1e-24  # of an output's mean square, below which it is met exactly


@dataclass(frozen=True, eq=False)
class FrequencyProblem:
    """What is fitted.

    Attributes
    ----------
    system : linear. records : their transforms. delays : position of an input -> name of the parameter by which it is late.
    names : the shared parameters. start, low, high : of them, ``(q,)``. prior : information on each, ``(q,)``, about the start; zero: none.
    bands : of each record, the noise band of each frequency.
    """

    system: System
    records: tuple[TransformedRecord, ...]
    delays: Mapping[int, str]
    names: tuple[str, ...]
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    prior: np.ndarray
    bands: tuple[np.ndarray, ...]
    iterations: int = 60
    tolerance: float = 1e-3

    @cached_property
    def positions(self) -> tuple[int, ...]:
        """Places of the shared parameters among the System's."""
        return tuple(self.system.parameters.index(name) for name in self.names)

    @cached_property
    def floor(self) -> np.ndarray:
        """Mean square below which an output is met to rounding, ``(m,)``."""
        power = np.sum([np.sum(np.abs(record.outputs) ** 2, axis=1) for record in self.records], axis=0)
        return np.maximum(_ROUNDING * power / sum(len(record.omega) for record in self.records), 1e-60)

    def columns(self, r: int) -> np.ndarray:
        """Positions in theta of what record ``r`` sees: the shared parameters and its own ends."""
        q, n = len(self.names), len(self.system.states)
        return np.concatenate([np.arange(q), q + r * n + np.arange(n)])

    @property
    def open(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values of all unknowns; the ends of a motion may be any."""
        free = np.full(len(self.records) * len(self.system.states), np.inf)
        return np.concatenate([self.low, -free]), np.concatenate([self.high, free])


@dataclass(frozen=True, eq=False)
class FrequencyFit:
    """A fit, finished or on its way: ``theta (k,)``; ``modelled (m, f)``, ``residuals (m, f)`` and ``slopes (m, f, c)`` a record; ``levels (m, b)``.

    ``counts (m, b)`` of complex residuals; ``cost`` minus the log likelihood less constants, the prior's term included.
    """

    problem: FrequencyProblem
    theta: np.ndarray
    modelled: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    levels: np.ndarray
    counts: np.ndarray
    cost: float
    outcome: Outcome = Outcome.MAX_ITERATIONS
    iterations: int = 0

    @property
    def log_likelihood(self) -> float:
        """Of the transforms within the band."""
        return -self.cost - float(self.counts.sum()) * (1.0 + np.log(np.pi))

    def weight(self, r: int) -> np.ndarray:
        """One over the variance of a real or imaginary part, ``(m, f)``, zero where an output was not recorded."""
        record = self.problem.records[r]
        return np.where(record.known[:, None], 2.0 / self.levels[:, self.problem.bands[r]], 0.0)

    @cached_property
    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Information ``(k, k)`` and gradient ``(k,)`` of the log likelihood."""
        information, gradient = np.zeros((len(self.theta),) * 2), np.zeros(len(self.theta))
        q = len(self.problem.names)
        information[range(q), range(q)] += self.problem.prior
        gradient[:q] += self.problem.prior * (self.problem.start - self.theta[:q])
        for r, (residual, slope) in enumerate(zip(self.residuals, self.slopes, strict=True)):
            parts = np.concatenate([residual.real, residual.imag], axis=1), np.concatenate([slope.real, slope.imag], axis=1)
            add_normal_equations(information, gradient, self.problem.columns(r), parts[1], parts[0], np.tile(self.weight(r), 2))
        return information, gradient

    @property
    def model(self) -> LocalModel:
        """The log likelihood about this point, within the bounds."""
        return local_model(*self.normal_equations, self.theta, *self.problem.open)


def at_start(problem: FrequencyProblem) -> FrequencyFit | None:
    """The start's parameters with the ends of each record's motion at their best; None where a number is not finite."""
    n, q = len(problem.system.states), len(problem.names)
    fit = evaluate(problem, np.concatenate([problem.start, np.zeros(n * len(problem.records))]))
    if fit is None:
        return None
    theta = fit.theta.copy()
    for r, (residual, slope) in enumerate(zip(fit.residuals, fit.slopes, strict=True)):
        root = np.sqrt(fit.weight(r))
        rows = (root[:, :, None] * slope[:, :, q:]).reshape(-1, n), (root * residual).ravel()
        real = [np.concatenate([each.real, each.imag]) for each in rows]
        theta[problem.columns(r)[q:]] += np.linalg.lstsq(real[0], real[1], rcond=None)[0]
    better = evaluate(problem, theta)
    return better if better is not None and better.cost < fit.cost else fit


def evaluate(problem: FrequencyProblem, theta: np.ndarray) -> FrequencyFit | None:
    """Residuals and slopes at ``theta``; None where they are not finite."""
    q, p = len(problem.names), problem.system.parameters.values()
    p[list(problem.positions)] = theta[:q]
    modelled, residuals, slopes = [], [], []
    with np.errstate(all="ignore"):
        model = linear_model(problem.system, p, problem.positions)
        delays = {i: _delay(problem, name, p) for i, name in problem.delays.items()}
        for r, record in enumerate(problem.records):
            try:
                found = response(model, record, delays, theta[problem.columns(r)[q:]])
            except (np.linalg.LinAlgError, ValueError):  # a root upon a harmonic, or matrices beyond all numbers
                return None
            slope = np.concatenate([found.by_parameter, found.by_ends], axis=2)
            if not (np.all(np.abs(found.y) < LARGEST) and np.all(np.abs(slope) < LARGEST)):
                return None
            modelled.append(found.y)
            residuals.append(np.where(record.known[:, None], record.outputs - found.y, 0.0))
            slopes.append(slope)
    known = [record.known for record in problem.records]
    level, counts = levels(residuals, known, problem.bands, problem.floor)
    away = theta[:q] - problem.start
    cost = float(np.sum(counts * np.log(level))) + 0.5 * float(away @ (problem.prior * away))
    return FrequencyFit(problem, theta, tuple(modelled), tuple(residuals), tuple(slopes), level, counts, cost)


def fit_transforms(problem: FrequencyProblem, begun: FrequencyFit | None = None) -> FrequencyFit | None:
    """Levenberg-Marquardt from the start, or from another fit's unknowns; None where no cost was finite.

    Outcomes ``CONVERGED`` and ``MAX_ITERATIONS``; whether all directions are determined is for the caller to judge.
    """
    fit = at_start(problem) if begun is None else evaluate(problem, np.clip(begun.theta, *problem.open))
    if fit is None:
        return None
    damping, costs, refused = 1e-4, [fit.cost], [False]
    while len(costs) <= problem.iterations and not _arrived(fit) and not _between(costs, refused):
        model = fit.model
        trial = evaluate(problem, np.clip(fit.theta + model.scale * model.step(damping), *problem.open))
        better = trial is not None and trial.cost <= fit.cost + unresolved(float(fit.counts.sum()))
        if trial is not None and better:
            fit, damping = trial, max(damping / 10.0, 1e-12)
        elif damping > _STEEPEST:
            break
        else:
            damping *= 10.0
        costs.append(fit.cost)
        refused.append(not better)
    settled = _arrived(fit) or _between(costs, refused)
    return replace(fit, outcome=Outcome.CONVERGED if settled else Outcome.MAX_ITERATIONS, iterations=len(costs) - 1)


def _arrived(fit: FrequencyFit) -> bool:
    return fit.model.promised < 0.5 * fit.problem.tolerance**2


def _between(costs: Sequence[float], refused: Sequence[bool]) -> bool:
    """Whether steps to either side lead nowhere: a delay of whole samples of a held input is a kink, and may be the best of all."""
    return len(costs) > _WINDOW and costs[-1 - _WINDOW] - costs[-1] < _NOTHING and any(refused[-_WINDOW:])


def _delay(problem: FrequencyProblem, name: str, p: np.ndarray) -> Delay:
    position = problem.names.index(name) if name in problem.names else None
    return Delay(float(p[problem.system.parameters.index(name)]), position)


def with_bands(problem: FrequencyProblem, bands: Sequence[np.ndarray]) -> FrequencyProblem:
    """The same problem with other bands of the noise."""
    return replace(problem, bands=tuple(bands))
