"""Noise levels by likelihood: those under which a campaign's records are most probable, beside those that its method assumes.

Of filters the sum of the innovations' log likelihoods over some runs, each with the declared start and priors, is maximised over a factor on each
measurement noise, one on the process noise of states and one on that of parameters (Schweppe 1965; Maine and Iliff 1981). Whole-record fits
estimate their measurement noise anyway; theirs is averaged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import filter_batched, run_bank
from ident.filters.ekf import run_ekf
from scenarios.studies.declaration import Estimation
from scenarios.studies.estimating import compiled, filter_settings
from scenarios.studies.runs.batch import Estimates, is_batched
from scenarios.studies.runs.work import EstimatorRuns
from sim.declaration.model import Noise
from sim.record import Record

RUNS, ALONE = 16, 4  # of which the likelihood is taken: of a batch, of filters one by one
LEAST, MOST = -7.0, 7.0  # of the logarithm of a factor on a standard deviation
BETTER = 2.0  # of a log likelihood: what tells one level from another
LITTLE = (-1.5, -3.5)  # logarithms of factors by which process noise that seemed to be none is tried again
BESIDE, STEPS, HALVINGS = 0.05, 6, 4  # of the search: differences of logarithms, Newton steps, and halvings of one that leads astray
STATES, PARAMETERS = "process noise of states", "process noise of parameters"
BEGUN = 0.02  # of a state's initial deviation in one second: where the search for undeclared process noise begins
CLOSE = 0.05  # share within which two levels are the same for every purpose


@dataclass(frozen=True)
class Level:
    """A noise level: an output's, or a common factor on process noise. ``assumed`` and ``found`` as standard deviations, SI; of process noise as
    factors on the declared ones: 1 where it is declared, else 0. ``spread``: of the logarithm of ``found`` by the likelihood's curvature."""

    name: str
    unit: str
    assumed: float
    found: float
    spread: float

    @property
    def agrees(self) -> bool:
        """Whether both are the same, by the likelihood or for every purpose."""
        if self.assumed == 0.0 or self.found == 0.0:
            return self.assumed == self.found
        off = abs(math.log(self.found / self.assumed))
        return off <= max(2.0 * self.spread, CLOSE)


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels over ``runs`` runs, and the estimation that assumes what was found; None of methods that assume none."""

    items: tuple[Level, ...]
    runs: int
    estimation: Estimation | None

    @property
    def agree(self) -> bool:
        """Whether all are as assumed."""
        return all(item.agrees for item in self.items)


def likely_levels(work: EstimatorRuns, seeds: Sequence[int]) -> Levels | None:
    """Noise levels by likelihood from the first runs of ``seeds``; None of equation error, whose residuals are no measurements."""
    estimation = work.estimation
    if estimation.method == "equation-error":
        return None
    if estimation.method not in ("ekf", "ukf"):
        records = [work.record_of(seed) for seed in seeds[:ALONE]]
        return _averaged(work, work.estimated(estimation, records))
    many = is_batched(replace(estimation, method="ekf"), bool(work.seen.flight.feedback))
    records = [work.record_of(seed) for seed in seeds[: RUNS if many else ALONE]]
    return _searched(work, records, many)


def _averaged(work: EstimatorRuns, found: Estimates) -> Levels:
    model = work.common.model
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    items = []
    for name, levels in zip(found.outputs, found.noise_std, strict=True):
        count = levels.size
        mean = float(np.sqrt(np.mean(levels**2)))
        spread = float(np.std(np.log(levels), ddof=1)) / count**0.5 if count > 1 else math.inf
        items.append(Level(name, units[name], model.noise.measurement_std[name], mean, spread))
    return Levels(tuple(items), found.noise_std.shape[1], None)


def _searched(work: EstimatorRuns, records: Sequence[Record], many: bool) -> Levels:
    plan = _Plan.of(work)
    cost = _cost_of(work, plan, records, many)
    theta, first = np.zeros(plan.size), len(plan.outputs)
    value = cost(theta)
    for at in range(first, plan.size):
        # Whether there is any process noise is asked, not read off a slope: towards none the likelihood is flat.
        theta, value = _better(cost, theta, value, at, -math.inf, BETTER if plan.declared else 0.0)
    theta, value, spreads = _newton(cost, theta, value)
    gone = [at for at in range(first, plan.size) if math.isinf(theta[at])]
    for at in gone:
        for little in LITTLE:
            theta, value = _better(cost, theta, value, at, little, -BETTER)
    if any(math.isfinite(theta[at]) for at in gone):
        theta, value, spreads = _newton(cost, theta, value)
    for at in range(first, plan.size):
        if math.isfinite(theta[at]):
            theta, value = _better(cost, theta, value, at, -math.inf, BETTER)
    return Levels(plan.levels(theta, spreads), len(records), plan.changed(theta))


def _better(cost: Callable[[np.ndarray], float], theta: np.ndarray, value: float, at: int, tried: float, allowed: float) -> tuple[np.ndarray, float]:
    """The logarithms with that of one factor as ``tried``, where that costs at most ``allowed`` more."""
    other = theta.copy()
    other[at] = tried
    costs = cost(other)
    return (other, costs) if costs <= value + allowed else (theta, value)


def _newton(cost: Callable[[np.ndarray], float], theta: np.ndarray, value: float) -> tuple[np.ndarray, float, np.ndarray]:
    """The least cost by Newton steps of each logarithm alone, which hardly know of each other; with their deviations by the curvature."""
    spreads = np.full(len(theta), math.inf)
    moving = np.flatnonzero(np.isfinite(theta))
    for _ in range(STEPS):
        slope, curvature = np.zeros(len(theta)), np.zeros(len(theta))
        for at in moving:
            sides = []
            for sign in (-1.0, 1.0):
                beside = theta.copy()
                beside[at] += sign * BESIDE
                sides.append(cost(beside))
            slope[at] = (sides[1] - sides[0]) / (2.0 * BESIDE)
            curvature[at] = (sides[0] - 2.0 * value + sides[1]) / BESIDE**2
        curved = curvature > 0.0
        newton = np.divide(-slope, curvature, out=-np.sign(slope), where=curved)
        spreads = np.where(curved, 1.0 / np.sqrt(np.where(curved, curvature, 1.0)), math.inf)
        step, reached = np.clip(newton, -1.0, 1.0), value
        for _ in range(HALVINGS):
            trial = np.clip(theta + step, LEAST, MOST)
            trial[~np.isfinite(theta)] = -math.inf
            reached = cost(trial)
            if reached <= value:
                theta, value = trial, reached
                break
            step = 0.5 * step
        if reached > value or np.all(np.abs(step[moving]) <= np.maximum(0.1 * spreads[moving], 1e-3)):
            break
    return theta, value, spreads


@dataclass(frozen=True)
class _Plan:
    """What is searched: ``outputs`` with their assumed levels, and groups of process noise with the densities at a factor of one."""

    estimation: Estimation
    outputs: Mapping[str, float]
    units: Mapping[str, str]
    groups: Mapping[str, Mapping[str, float]]
    declared: bool

    @classmethod
    def of(cls, work: EstimatorRuns) -> _Plan:
        model, estimation = work.common.model, work.estimation
        system = compiled(estimation, model)
        outputs = {name: model.noise.measurement_std[name] for name in system.output_names}
        units = {signal.name: signal.unit for signal in model.equations.outputs}
        density = estimation.process_noise or {
            name: (BEGUN * each.std) ** 2 for name, each in estimation.initial.items() if 0.0 < each.std < math.inf
        }
        states = {name: value for name, value in density.items() if name not in estimation.start}
        parameters = {name: value for name, value in density.items() if name in estimation.start}
        groups = {name: group for name, group in ((STATES, states), (PARAMETERS, parameters)) if group}
        return cls(estimation, outputs, units, groups, bool(estimation.process_noise))

    @property
    def size(self) -> int:
        return len(self.outputs) + len(self.groups)

    def noise(self, theta: np.ndarray) -> Noise:
        """Levels at logarithms of factors on standard deviations ``(size,)``."""
        factors = np.exp(theta)
        told = {name: float(value * factor) for (name, value), factor in zip(self.outputs.items(), factors, strict=False)}
        density: dict[str, float] = {}
        for group, factor in zip(self.groups.values(), factors[len(told) :], strict=True):
            density |= {name: float(value * factor**2) for name, value in group.items() if factor > 0.0}
        return Noise(told, density)

    def changed(self, theta: np.ndarray) -> Estimation:
        noise = self.noise(theta)
        return replace(self.estimation, noise_std=noise.measurement_std, process_noise=noise.process_density)

    def levels(self, theta: np.ndarray, spreads: np.ndarray) -> tuple[Level, ...]:
        found = np.exp(theta)
        ours = [
            Level(name, self.units[name], value, float(value * found[at]), float(spreads[at]))
            for at, (name, value) in enumerate(self.outputs.items())
        ]
        first = len(ours)
        forced = [
            Level(name, "1", 1.0 if self.declared else 0.0, float(found[first + at]), float(spreads[first + at]))
            for at, name in enumerate(self.groups)
        ]
        return (*ours, *forced)


def _cost_of(work: EstimatorRuns, plan: _Plan, records: Sequence[Record], many: bool) -> Callable[[np.ndarray], float]:
    """Minus the log likelihood of all records by the logarithms of factors."""
    model, estimation = work.common.model, work.estimation
    # What coarse steps leave is no noise.
    once = filter_settings(replace(estimation, integration="rk4", terms=3 if estimation.terms else 0, passes=1))
    names = compiled(estimation, model).output_names
    z = np.stack([record.output_array(names)[0] for record in records], axis=2) if many else None

    def cost(theta: np.ndarray) -> float:
        system = compiled(estimation, model.with_noise(plan.noise(theta)))
        if z is not None:
            total = float(run_bank(records[0], system, once, z=z).log_likelihood.sum())
        else:
            total = float(sum(run_ekf(record, system, once, by=filter_batched).log_likelihood for record in records))
        return -total if math.isfinite(total) else 1e12

    return cost
