"""A set of effects at its posterior mode: fit, noise laws and log evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.evidence.linear_world import Laws, LinearWorld, Solution
from ident.evidence.noise_law import NoiseLaw
from ident.evidence.priors import log_odds
from ident.tracing.candidate_model.fitted_model import FittedModel, Start, Values, fit_set
from ident.tracing.candidate_model.problem import TraceProblem
from ident.whole_record.gauss_newton import carried, evaluate
from ident.whole_record.layout import FitSettings
from sim.declaration.proposal import SearchContext, Traceable

Key = frozenset[str]


@dataclass(frozen=True, eq=False)
class Assessed:
    """A set of effects at its posterior mode.

    ``extra`` : effects that act as ``world.beside``. ``weight`` : log posterior of the set, but for
    a constant.
    """

    world: LinearWorld
    laws: Laws
    solution: Solution
    evidence: float
    weight: float
    extra: tuple[Traceable, ...] = ()

    @property
    def fitted(self) -> FittedModel:
        """The fit that it is linearised at."""
        return self.world.fitted

    @property
    def effects(self) -> tuple[Traceable, ...]:
        """All effects of the set."""
        return (*self.fitted.effects, *self.extra)

    @property
    def names(self) -> Key:
        """Names of all effects of the set."""
        return frozenset(effect.name for effect in self.effects)

    def value(self, name: str) -> tuple[float, float]:
        """An unknown by its full name: posterior mean and standard deviation."""
        at = self.fitted.fit.layout.names.index(name)
        value = float(self.fitted.fit.theta[at] + self.solution.offset[at])
        return value, math.sqrt(max(self.solution.covariance[at, at], 0.0))


def first_laws(fitted: FittedModel) -> Laws:
    """Noise laws to begin with, from the residuals' size."""
    sizes = np.sqrt(np.maximum(fitted.fit.variance, 1e-20))
    return tuple(NoiseLaw(0.5 * size, 0.8 * size, 0.5) for size in sizes.tolist())


def begun(
    problem: TraceProblem, effects: Sequence[Traceable], values: Values, added: Sequence[Mapping[str, float]]
) -> FittedModel | None:
    """A set of effects at given values, not fitted; ``added`` the new parameters of each record."""
    shared = {name: value for one in added for name, value in one.items()}
    own = tuple({**mine, **one} for mine, one in zip(values.own, added, strict=True))
    start = Start(Values({**shared, **values.shared}, own, values.states))
    settings = FitSettings(max_step=problem.settings.max_step, iterations=0, tolerance=0.03, enough=0.2)
    return fit_set(problem.data, tuple(effects), settings, start)


def moved(fitted: FittedModel, theta: np.ndarray) -> FittedModel | None:
    """The same set at other unknowns ``(n,)``, linearised there; None where that is not finite."""
    fit = evaluate(fitted.fit.problem, theta, carried(fitted.fit, theta))
    if fit is None:
        return None
    again = evaluate(fit.problem, theta, [line.states for line in fit.lines])
    return replace(fitted, fit=again or fit)


def settled(world: LinearWorld, laws: Laws, steps: int = 4) -> tuple[LinearWorld, Solution]:
    """Gauss-Newton steps to the posterior mode under given noise laws."""
    solution = world.solution(laws)
    for _ in range(steps):
        fit = world.fitted.fit
        n = len(fit.theta)
        sigma = np.sqrt(np.abs(np.diag(solution.covariance)))[:n]
        step = solution.offset[:n]
        inside = np.clip(fit.theta + step, fit.layout.low, fit.layout.high) - fit.theta
        if np.max(np.abs(inside) / np.maximum(sigma, 1e-12)) < 0.05:
            break
        here = world.misfit(laws, np.zeros(world.size))
        better = None
        for share in (1.0, 0.3, 0.1, 0.03):
            theta = np.clip(fit.theta + share * step, fit.layout.low, fit.layout.high)
            fitted = moved(world.fitted, theta)
            if fitted is None:
                continue
            trial = LinearWorld(fitted, world.context, world.beside, world.knowledge)
            rest = np.zeros(trial.size)
            rest[n:] = solution.offset[n:]
            if trial.misfit(laws, rest) < here + 1e-3:
                better = trial
                break
        if better is None:
            break
        world, solution = better, better.solution(laws)
    return world, solution


def assess(
    world: LinearWorld,
    laws: Laws,
    candidates: Sequence[Traceable],
    extra: tuple[Traceable, ...] = (),
    *,
    sweeps: int = 2,
    prior: float = 0.0,
) -> Assessed:
    """Bring a set to its posterior mode, estimate its noise, and weigh it.

    ``prior`` : log prior of what ``extra`` adds beyond its columns.
    """
    world, _ = settled(world, laws)
    if sweeps:
        laws = world.best_laws(laws, sweeps, 14)
    world, solution = settled(world, laws, 2)
    evidence = solution.evidence + world.log_prior(laws) + prior
    odds = log_odds((*world.fitted.effects, *extra), candidates)
    return Assessed(world, laws, solution, evidence, evidence + odds, extra)


