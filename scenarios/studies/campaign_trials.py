"""Trials on the first runs of a campaign: noise levels by likelihood, changed methods.

The noise levels of a filter maximize the likelihood of the innovations, summed over some runs with
the declared start and priors (Schweppe 1965; Maine and Iliff 1981). The unknowns are a factor on
each measurement noise, a factor on the process noise of states and one on that of parameters. A fit
of a whole record estimates the measurement noise of its run; the average over runs is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ident.banks.bank import filter_batched, run_bank
from ident.filters.ekf import run_ekf
from ident.statistics.intervals import mean_square_interval
from scenarios.studies.campaign import SOUND, CampaignRuns, EstimatorRuns
from scenarios.studies.declaration import FILTERS, Estimation, Start
from scenarios.studies.estimating import FIT_STEP, Estimates, compiled, filter_settings, is_batched
from sim.declaration.model import Noise
from sim.errors import FlightidError
from sim.record import Record

# ---- Noise levels by likelihood

LIKELIHOOD_RUNS, LIKELIHOOD_RUNS_ALONE = 16, 4  # runs: in a batch of filters, one by one
LEAST, MOST = -7.0, 7.0  # bounds on the logarithm of a factor on a sigma
BETTER_LOG_LIKELIHOOD = 2.0  # two levels with a larger difference of log likelihood differ
# Logarithms of small factors, which are tried if the search found no process noise.
SMALL_FACTORS = (-1.5, -3.5)
# Step of finite differences; largest numbers of Newton steps and of step halvings.
DIFFERENCE_STEP, NEWTON_STEPS, HALVINGS = 0.05, 6, 4
STATES, PARAMETERS = "process noise of states", "process noise of parameters"
# Undeclared process noise starts at this share of a state's initial sigma in one second.
STARTING_NOISE_SHARE = 0.02
SAME_LEVEL_SHARE = 0.05  # a smaller relative difference of levels does not matter in practice


@dataclass(frozen=True)
class Level:
    """Noise level of an output, or a common factor on process noise.

    Attributes
    ----------
    name : the output, or what the process noise drives.
    unit : unit of the level; 1 for a factor.
    assumed : standard deviation, SI. Of process noise: 1 if it is declared, else 0.
    found : standard deviation by likelihood, SI. Of process noise: factor on the declared one.
    spread : standard deviation of the logarithm of ``found``.
    """

    name: str
    unit: str
    assumed: float
    found: float
    spread: float

    @property
    def agrees(self) -> bool:
        """Whether the difference of the levels is not significant, or too small to matter."""
        if self.assumed == 0.0 or self.found == 0.0:
            return self.assumed == self.found
        difference = abs(math.log(self.found / self.assumed))
        return difference <= max(2.0 * self.spread, SAME_LEVEL_SHARE)


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise levels by likelihood.

    Attributes
    ----------
    items : the levels.
    runs : number of runs that determine them.
    estimation : the method with these levels; None if the method assumes no levels.
    """

    items: tuple[Level, ...]
    runs: int
    estimation: Estimation | None

    @property
    def agree(self) -> bool:
        """Whether all levels agree with the assumed ones."""
        return all(item.agrees for item in self.items)


def likely_levels(work: EstimatorRuns, seeds: Sequence[int]) -> Levels | None:
    """Return the noise levels by likelihood from the first runs of ``seeds``.

    None for equation error, whose residuals are not measurement errors.
    """
    estimation = work.estimation
    if estimation.method == "equation-error":
        return None
    if estimation.method not in ("ekf", "ukf"):
        records = [work.record_of(seed) for seed in seeds[:LIKELIHOOD_RUNS_ALONE]]
        return _average_levels(work, work.estimated(estimation, records))
    batched = is_batched(replace(estimation, method="ekf"), bool(work.seen.flight.feedback))
    count = LIKELIHOOD_RUNS if batched else LIKELIHOOD_RUNS_ALONE
    records = [work.record_of(seed) for seed in seeds[:count]]
    return _searched_levels(work, records, batched)


def _average_levels(work: EstimatorRuns, estimates: Estimates) -> Levels:
    """Return the rms over runs of the noise levels that fits of whole records estimate."""
    model = work.common.model
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    items = []
    for name, levels in zip(estimates.outputs, estimates.noise_std, strict=True):
        count = levels.size
        mean = float(np.sqrt(np.mean(levels**2)))
        spread = float(np.std(np.log(levels), ddof=1)) / count**0.5 if count > 1 else math.inf
        items.append(Level(name, units[name], model.noise.measurement_std[name], mean, spread))
    return Levels(tuple(items), estimates.noise_std.shape[1], None)


def _searched_levels(work: EstimatorRuns, records: Sequence[Record], batched: bool) -> Levels:
    """Return the noise levels of a filter by a search for the largest likelihood."""
    plan = _Plan.of(work)
    cost = _cost_of(work, plan, records, batched)
    theta, first = np.zeros(plan.size), len(plan.outputs)
    value = cost(theta)
    for at in range(first, plan.size):
        # The likelihood is flat towards zero process noise, so zero is compared explicitly.
        allowed = BETTER_LOG_LIKELIHOOD if plan.declared else 0.0
        theta, value = _better(cost, theta, value, at, -math.inf, allowed)
    theta, value, spreads = _newton(cost, theta, value)
    at_zero = [at for at in range(first, plan.size) if math.isinf(theta[at])]
    for at in at_zero:
        for small in SMALL_FACTORS:
            theta, value = _better(cost, theta, value, at, small, -BETTER_LOG_LIKELIHOOD)
    if any(math.isfinite(theta[at]) for at in at_zero):
        theta, value, spreads = _newton(cost, theta, value)
    for at in range(first, plan.size):
        if math.isfinite(theta[at]):
            theta, value = _better(cost, theta, value, at, -math.inf, BETTER_LOG_LIKELIHOOD)
    return Levels(plan.levels(theta, spreads), len(records), plan.changed(theta))


def _better(
    cost: Callable[[np.ndarray], float],
    theta: np.ndarray,
    value: float,
    at: int,
    tried: float,
    allowed: float,
) -> tuple[np.ndarray, float]:
    """Return ``theta`` with entry ``at`` set to ``tried`` if its cost permits, and the cost.

    ``value``: cost of ``theta``. ``allowed``: largest increase of the cost.
    """
    trial = theta.copy()
    trial[at] = tried
    trial_cost = cost(trial)
    return (trial, trial_cost) if trial_cost <= value + allowed else (theta, value)


def _newton(
    cost: Callable[[np.ndarray], float], theta: np.ndarray, value: float
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the minimum of the cost, its value, and the sigmas of the logarithms by its curvature.

    Each logarithm has its own Newton step, since the logarithms are nearly uncorrelated.
    """
    spreads = np.full(len(theta), math.inf)
    moving = np.flatnonzero(np.isfinite(theta))
    for _ in range(NEWTON_STEPS):
        slope, curvature = np.zeros(len(theta)), np.zeros(len(theta))
        for at in moving:
            sides = []
            for sign in (-1.0, 1.0):
                beside = theta.copy()
                beside[at] += sign * DIFFERENCE_STEP
                sides.append(cost(beside))
            slope[at] = (sides[1] - sides[0]) / (2.0 * DIFFERENCE_STEP)
            curvature[at] = (sides[0] - 2.0 * value + sides[1]) / DIFFERENCE_STEP**2
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
        if reached > value or np.all(
            np.abs(step[moving]) <= np.maximum(0.1 * spreads[moving], 1e-3)
        ):
            break
    return theta, value, spreads


@dataclass(frozen=True)
class _Plan:
    """Unknowns of the search: factors on the noise of outputs and on groups of process noise.

    Attributes
    ----------
    estimation : the method.
    outputs : assumed noise level by output.
    units : unit by output.
    groups : spectral densities of each group of process noise for a factor of one.
    declared : whether the method declares process noise.
    """

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
            name: (STARTING_NOISE_SHARE * start.std) ** 2
            for name, start in estimation.initial.items()
            if 0.0 < start.std < math.inf
        }
        states = {name: value for name, value in density.items() if name not in estimation.start}
        parameters = {name: value for name, value in density.items() if name in estimation.start}
        groups = {
            name: group for name, group in ((STATES, states), (PARAMETERS, parameters)) if group
        }
        return cls(estimation, outputs, units, groups, bool(estimation.process_noise))

    @property
    def size(self) -> int:
        return len(self.outputs) + len(self.groups)

    def noise(self, theta: np.ndarray) -> Noise:
        """Return the noise for logarithms of the factors on standard deviations, ``(size,)``."""
        factors = np.exp(theta)
        measurement = {
            name: float(value * factor)
            for (name, value), factor in zip(self.outputs.items(), factors, strict=False)
        }
        density: dict[str, float] = {}
        for group, factor in zip(self.groups.values(), factors[len(measurement) :], strict=True):
            density |= {
                name: float(value * factor**2) for name, value in group.items() if factor > 0.0
            }
        return Noise(measurement, density)

    def changed(self, theta: np.ndarray) -> Estimation:
        """Return the method with the noise at these logarithms."""
        noise = self.noise(theta)
        return replace(
            self.estimation, noise_std=noise.measurement_std, process_noise=noise.process_density
        )

    def levels(self, theta: np.ndarray, spreads: np.ndarray) -> tuple[Level, ...]:
        """Return the levels at these logarithms, which have the sigmas ``spreads``."""
        factors, assumed = np.exp(theta), 1.0 if self.declared else 0.0
        measurement = [
            Level(name, self.units[name], value, float(value * factors[at]), float(spreads[at]))
            for at, (name, value) in enumerate(self.outputs.items())
        ]
        process = [
            Level(name, "1", assumed, float(factors[at]), float(spreads[at]))
            for at, name in enumerate(self.groups, start=len(measurement))
        ]
        return (*measurement, *process)


def _cost_of(
    work: EstimatorRuns, plan: _Plan, records: Sequence[Record], batched: bool
) -> Callable[[np.ndarray], float]:
    """Return minus the log likelihood of all records as a function of the logarithms."""
    model, estimation = work.common.model, work.estimation
    # Fine steps, so that integration error does not count as noise.
    one_pass = filter_settings(
        replace(estimation, integration="rk4", terms=3 if estimation.terms else 0, passes=1)
    )
    names = compiled(estimation, model).output_names
    z = np.stack([record.output_array(names)[0] for record in records], axis=2) if batched else None

    def cost(theta: np.ndarray) -> float:
        system = compiled(estimation, model.with_noise(plan.noise(theta)))
        if z is not None:
            total = float(run_bank(records[0], system, one_pass, z=z).log_likelihood.sum())
        else:
            total = float(
                sum(
                    run_ekf(record, system, one_pass, by=filter_batched).log_likelihood
                    for record in records
                )
            )
        return -total if math.isfinite(total) else 1e12

    return cost


# ---- First runs of a campaign repeated with a changed method

TRIALS_RUNS, TRIALS_ALONE = 64, 12  # runs that are repeated: in a batch, one by one
FURTHER_PASSES = 3
PASS_SPREAD = 20.0  # prior of a further pass, in sigmas of the pass before
REDUCED_NOISE_SHARE = 0.1  # noise of a quiet trial over the declared noise
FILTER_STEPS_PER_SAMPLE = 4  # integration steps between samples, in the trial with finer steps
LONGEST_FINE_STEP = 0.02  # s, longest step of a filter for which finer steps are not tried

START, TRIALS_STEPS, LEVELS = "start", "steps", "levels"


@dataclass(frozen=True, eq=False)
class Trial:
    """Runs of a changed method.

    Attributes
    ----------
    keys : the changes.
    errors : errors of the runs that converged, shape ``(n, K)``.
    std : their reported sigmas, shape ``(n, K)``.
    """

    keys: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray

    def rms(self, at: int) -> float:
        """Return the rms error of parameter ``at``, in reported sigmas."""
        return float(np.sqrt(np.mean((self.errors[at] / self.std[at]) ** 2)))

    def right(self, at: int) -> bool:
        """Return whether the rms error of parameter ``at`` agrees with correct sigmas (99.9 %)."""
        low, high = mean_square_interval(self.errors.shape[1], 0.999)
        return low <= self.rms(at) ** 2 <= high


@dataclass(frozen=True, eq=False)
class Trials:
    """First runs of a campaign, unchanged and with sets of changes; each set is computed once.

    Attributes
    ----------
    work : runs of the method.
    names : names of the parameters.
    reference : reference values, shape ``(n,)``.
    seeds : seeds of the runs.
    changes : changed method by change.
    done : trials that were computed, by their changes.
    scale : factors on the reported sigmas for coloured noise, shape ``(n,)``.
    """

    work: EstimatorRuns
    names: tuple[str, ...]
    reference: np.ndarray
    seeds: tuple[int, ...]
    changes: Mapping[str, Estimation]
    done: dict[tuple[str, ...], Trial | None]
    scale: np.ndarray

    @classmethod
    def of(
        cls, campaign: CampaignRuns, levels: Levels | None, scale: np.ndarray | None = None
    ) -> Trials:
        """Return the trials of a campaign, on its first runs that converged; none is computed."""
        work = campaign.work
        batched = is_batched(campaign.estimation, bool(campaign.scenario.flight.feedback))
        count = TRIALS_RUNS if batched else TRIALS_ALONE
        seeds = tuple(int(seed) for seed in campaign.seeds[campaign.kept][:count])
        reference = np.array([spread.reference for spread in campaign.spreads])
        return cls(
            work,
            campaign.names,
            reference,
            seeds,
            _changes(work, levels, reference),
            {},
            np.ones(len(reference)) if scale is None else scale,
        )

    @property
    def subsets(self) -> Iterator[tuple[str, ...]]:
        """Yield the sets of changes, the smallest first."""
        for size in range(0 if np.any(self.scale != 1.0) else 1, len(self.changes) + 1):
            yield from combinations(self.changes, size)

    def trial(self, keys: tuple[str, ...]) -> Trial | None:
        """Return the runs with these changes; None if fewer than half of them converge."""
        if keys not in self.done:
            self.done[keys] = self._computed(keys)
        return self.done[keys]

    def _computed(self, keys: tuple[str, ...]) -> Trial | None:
        estimation = self.work.estimation
        for key in keys:
            estimation = _merged(estimation, self.changes[key], key)
        return self.of_records(keys, estimation, [self.work.record_of(seed) for seed in self.seeds])

    def of_records(
        self, keys: tuple[str, ...], estimation: Estimation, records: Sequence[Record]
    ) -> Trial | None:
        """Return a trial of a changed method; None if fewer than half of the runs converge."""
        try:
            estimates = self.work.estimated(estimation, records)
        except FlightidError:
            return None
        order = [estimates.names.index(name) for name in self.names]
        values = estimates.values[order]
        std = estimates.std[order]
        converged = np.array([outcome == SOUND for outcome in estimates.outcomes]) & np.all(
            np.isfinite(values) & (std > 0.0), axis=0
        )
        if 2 * np.sum(converged) < len(self.seeds):
            return None
        return Trial(
            keys,
            values[:, converged] - self.reference[:, None],
            self.scale[:, None] * std[:, converged],
        )


def _changes(
    work: EstimatorRuns, levels: Levels | None, reference: np.ndarray
) -> Mapping[str, Estimation]:
    """Return the changed method for each possible change."""
    estimation = work.estimation
    if estimation.method == "equation-error":
        return {}
    changes = {}
    if estimation.method in FILTERS:
        changes[START] = replace(
            estimation,
            passes=estimation.passes + FURTHER_PASSES,
            spread=min(estimation.spread, PASS_SPREAD),
        )
        step = 1.0 / (FILTER_STEPS_PER_SAMPLE * work.seen.flight.rate)
        if (
            estimation.integration != "rk4"
            or 0 < estimation.terms < 3
            or min(estimation.max_step, FILTER_STEPS_PER_SAMPLE * step) > LONGEST_FINE_STEP
        ):
            changes[TRIALS_STEPS] = replace(
                estimation, integration="rk4", terms=3, max_step=min(estimation.max_step, step)
            )
        if levels is not None and levels.estimation is not None and not levels.agree:
            changes[LEVELS] = levels.estimation
        return changes
    truth = dict(zip(work.parameters, reference.tolist(), strict=True))
    changes[START] = replace(
        estimation,
        start={
            name: Start(truth.get(name, start.value), start.std)
            for name, start in estimation.start.items()
        },
    )
    if estimation.own is None:
        finer = min(estimation.max_step, FIT_STEP) / FILTER_STEPS_PER_SAMPLE
        changes[TRIALS_STEPS] = replace(estimation, max_step=finer)
    return changes


def _merged(estimation: Estimation, changed: Estimation, key: str) -> Estimation:
    """Return an estimation with one more change."""
    if key == TRIALS_STEPS:
        return replace(
            estimation,
            integration=changed.integration,
            terms=changed.terms,
            max_step=changed.max_step,
        )
    if key == LEVELS:
        return replace(estimation, noise_std=changed.noise_std, process_noise=changed.process_noise)
    return replace(estimation, passes=changed.passes, spread=changed.spread, start=changed.start)


def closest(trials: Trials, at: Sequence[int]) -> dict[int, Trial]:
    """Return, for each parameter, the trial of the smallest set of changes that corrects its sigma.

    ``at``: indices of the parameters. A parameter without such a set is not in the result.
    """
    correcting: dict[int, Trial] = {}
    unchanged = trials.trial(())
    for keys in trials.subsets:
        if len(correcting) == len(at):
            break
        trial = trials.trial(keys)
        if trial is None:
            continue
        for parameter in at:
            if parameter in correcting or not trial.right(parameter):
                continue
            # The scale for coloured noise may be enough without any change.
            if not keys or _nearer(trial, unchanged, parameter):
                correcting[parameter] = trial
    return correcting


def _nearer(trial: Trial, unchanged: Trial | None, at: int) -> bool:
    """Return whether a change at least halves the error of the sigma.

    With few runs, a nearly correct sigma passes the test even without the change.
    """
    return unchanged is None or abs(math.log(trial.rms(at))) < 0.5 * abs(
        math.log(unchanged.rms(at))
    )


def quiet_trial(trials: Trials) -> Trial | None:
    """Return the runs with a tenth of the noise.

    In sigmas, a bias that noise causes is then a tenth; any other bias is ten times as large.
    """
    work = trials.work
    noise = {
        name: REDUCED_NOISE_SHARE * value
        for name, value in work.common.truth.noise_std.items()
        if value > 0.0
    }
    measurement = {
        name: REDUCED_NOISE_SHARE * value
        for name, value in work.common.model.noise.measurement_std.items()
    }
    estimation = replace(work.estimation, flown_noise_std=noise, noise_std=measurement)
    quiet = EstimatorRuns(work.scenario, estimation)
    records = [quiet.record_of(seed) for seed in trials.seeds]
    return trials.of_records(("quiet",), estimation, records)
