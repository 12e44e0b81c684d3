"""Trials on the first runs of a campaign: noise levels by likelihood, residuals, changed methods.

Noise levels of filters maximise the innovations' likelihood, summed over some runs with the
declared start and priors (Schweppe 1965; Maine and Iliff 1981). Free are a factor on each
measurement noise, one on the process noise of states and one on that of parameters. Whole-record
fits estimate their measurement noise in each run; the average is used.

Residuals are computed with the parameters held at the reference and fine integration steps, so
that they do not depend on start or step. With the sensitivities S in units of the noise and the
stated covariance P, a misfit d shifts the estimates by P S' d, and noise of autocovariance R gives
them the covariance P S' R S P.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ident.banks.bank import filter_batched, run_bank
from ident.filters.ekf import FilterSettings, run_ekf
from ident.statistics.intervals import mean_square_interval
from ident.statistics.residual_spectrum import autocovariance, filtered_product
from scenarios.studies.campaign import SOUND, CampaignRuns, EstimatorRuns
from scenarios.studies.campaign_statistics import Bound
from scenarios.studies.declaration import FILTERS, Estimation, Start
from scenarios.studies.estimating import Estimates, compiled, filter_settings, is_batched
from sim.declaration.model import Noise
from sim.errors import FlightidError
from sim.record import Record

# ---- Noise levels by likelihood

RUNS, ALONE = 16, 4  # runs in the likelihood: batched filters, other filters
LEAST, MOST = -7.0, 7.0  # bounds on the logarithm of a factor on a sigma
BETTER_LOG_LIKELIHOOD = 2.0  # difference above which two levels differ
# Logarithms of factors tried for process noise that the search found negligible.
LITTLE = (-1.5, -3.5)
# Search: step of finite differences, largest number of Newton steps and of step halvings.
BESIDE, STEPS, HALVINGS = 0.05, 6, 4
STATES, PARAMETERS = "process noise of states", "process noise of parameters"
# Start of the search for undeclared process noise: share of a state's initial sigma in one second.
STARTING_NOISE_SHARE = 0.02
SAME_LEVEL_SHARE = 0.05  # relative difference that is irrelevant in practice


@dataclass(frozen=True)
class Level:
    """Noise level of an output, or common factor on process noise.

    ``assumed``, ``found``: standard deviations, SI; for process noise, factors on the declared
    ones (assumed is 1 if declared, else 0). ``spread``: sigma of the logarithm of ``found``.
    """

    name: str
    unit: str
    assumed: float
    found: float
    spread: float

    @property
    def agrees(self) -> bool:
        """Whether the levels do not differ significantly, or not in practice."""
        if self.assumed == 0.0 or self.found == 0.0:
            return self.assumed == self.found
        off = abs(math.log(self.found / self.assumed))
        return off <= max(2.0 * self.spread, SAME_LEVEL_SHARE)


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels found from ``runs`` runs.

    ``estimation``: the method with these levels; None if the method assumes no levels.
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
        # The likelihood is flat towards zero process noise, so zero is compared explicitly.
        theta, value = _better(
            cost, theta, value, at, -math.inf, BETTER_LOG_LIKELIHOOD if plan.declared else 0.0
        )
    theta, value, spreads = _newton(cost, theta, value)
    gone = [at for at in range(first, plan.size) if math.isinf(theta[at])]
    for at in gone:
        for little in LITTLE:
            theta, value = _better(cost, theta, value, at, little, -BETTER_LOG_LIKELIHOOD)
    if any(math.isfinite(theta[at]) for at in gone):
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
    """Return ``theta`` and its cost, with entry ``at`` set to ``tried`` if the cost permits.

    ``allowed``: largest increase of the cost.
    """
    other = theta.copy()
    other[at] = tried
    costs = cost(other)
    return (other, costs) if costs <= value + allowed else (theta, value)


def _newton(
    cost: Callable[[np.ndarray], float], theta: np.ndarray, value: float
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the minimum of the cost, its value and the sigmas of the logarithms by curvature.

    Newton steps in each logarithm separately: they are nearly uncorrelated.
    """
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
        if reached > value or np.all(
            np.abs(step[moving]) <= np.maximum(0.1 * spreads[moving], 1e-3)
        ):
            break
    return theta, value, spreads


@dataclass(frozen=True)
class _Plan:
    """Unknowns of the search: measurement noise by output, and groups of process noise.

    ``outputs``: assumed levels. ``groups``: spectral densities at a factor of one.
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
            name: (STARTING_NOISE_SHARE * each.std) ** 2
            for name, each in estimation.initial.items()
            if 0.0 < each.std < math.inf
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
        """Return the levels at logarithms of factors on standard deviations ``(size,)``."""
        factors = np.exp(theta)
        told = {
            name: float(value * factor)
            for (name, value), factor in zip(self.outputs.items(), factors, strict=False)
        }
        density: dict[str, float] = {}
        for group, factor in zip(self.groups.values(), factors[len(told) :], strict=True):
            density |= {
                name: float(value * factor**2) for name, value in group.items() if factor > 0.0
            }
        return Noise(told, density)

    def changed(self, theta: np.ndarray) -> Estimation:
        noise = self.noise(theta)
        return replace(
            self.estimation, noise_std=noise.measurement_std, process_noise=noise.process_density
        )

    def levels(self, theta: np.ndarray, spreads: np.ndarray) -> tuple[Level, ...]:
        found = np.exp(theta)
        ours = [
            Level(name, self.units[name], value, float(value * found[at]), float(spreads[at]))
            for at, (name, value) in enumerate(self.outputs.items())
        ]
        first = len(ours)
        forced = [
            Level(
                name,
                "1",
                1.0 if self.declared else 0.0,
                float(found[first + at]),
                float(spreads[first + at]),
            )
            for at, name in enumerate(self.groups)
        ]
        return (*ours, *forced)


def _cost_of(
    work: EstimatorRuns, plan: _Plan, records: Sequence[Record], many: bool
) -> Callable[[np.ndarray], float]:
    """Return minus the log likelihood of all records as a function of the logarithms."""
    model, estimation = work.common.model, work.estimation
    # Fine steps, so that integration error does not count as noise.
    once = filter_settings(
        replace(estimation, integration="rk4", terms=3 if estimation.terms else 0, passes=1)
    )
    names = compiled(estimation, model).output_names
    z = np.stack([record.output_array(names)[0] for record in records], axis=2) if many else None

    def cost(theta: np.ndarray) -> float:
        system = compiled(estimation, model.with_noise(plan.noise(theta)))
        if z is not None:
            total = float(run_bank(records[0], system, once, z=z).log_likelihood.sum())
        else:
            total = float(
                sum(
                    run_ekf(record, system, once, by=filter_batched).log_likelihood
                    for record in records
                )
            )
        return -total if math.isfinite(total) else 1e12

    return cost


# ---- Residuals at the reference values

RESIDUALS_RUNS, RESIDUALS_ALONE = 32, 6  # runs used: batched methods, other methods
HELD_PRIOR_SHARE = 1e-6  # prior sigma that holds a parameter, share of the declared one
STEPS_PER_SAMPLE = 4


@dataclass(frozen=True, eq=False)
class Residuals:
    """Normalised residuals of m outputs, as the mean over runs (misfit) and the noise about it.

    Attributes
    ----------
    misfit : root mean square of the mean over runs, in noise standard deviations.
    colour : ``(m,)``, correlation of neighbouring noise samples.
    colour_std : standard deviation of ``colour`` for white noise.
    lags : ``(m, L)``, autocovariance of the noise.
    valid, common : ``(m, N)``, True for measured samples; mean over runs.
    """

    misfit: float
    colour: np.ndarray
    colour_std: float
    outputs: tuple[str, ...]
    lags: np.ndarray
    valid: np.ndarray
    common: np.ndarray

    @property
    def coloured(self) -> bool:
        """Whether the noise of an output is not white."""
        return bool(np.any(np.abs(self.colour) > max(5.0 * self.colour_std, 0.05)))


def residuals_of(work: EstimatorRuns, seeds: Sequence[int]) -> Residuals | None:
    """Return the residuals of the first runs; None if the model held at the reference diverges."""
    estimation, reference = work.estimation, work.common.reference
    model = work.common.model.with_values({name: reference[name] for name in work.parameters})
    held = {name: HELD_PRIOR_SHARE * max(abs(reference[name]), 1e-3) for name in work.parameters}
    model = replace(model, parameters=model.parameters.with_prior(held)).with_noise(
        replace(model.noise, process_density={})
    )
    filtered = replace(estimation, method="ekf", process_noise={}, passes=1)
    system = compiled(filtered, model)
    settings = FilterSettings(max_step=1.0 / (STEPS_PER_SAMPLE * work.seen.flight.rate))
    many = is_batched(filtered, bool(work.seen.flight.feedback))
    records = [
        work.record_of(seed) for seed in seeds[: RESIDUALS_RUNS if many else RESIDUALS_ALONE]
    ]
    try:
        if many:
            z = np.stack(
                [record.output_array(system.output_names)[0] for record in records], axis=2
            )
            bank = run_bank(records[0], system, settings, z=z, keep=True)
            assert bank.innovation is not None and bank.innovation_std is not None
            normal = bank.innovation / bank.innovation_std
            sound = bool(np.all(bank.sound))
        else:
            histories = [
                run_ekf(record, system, settings, by=filter_batched).history for record in records
            ]
            normal = np.stack(
                [h.innovation / h.innovation_std for h in histories if h is not None], axis=2
            )
            sound = normal.shape[2] == len(records)
    except FlightidError:
        return None
    valid = records[0].output_array(system.output_names)[1]
    return (
        split(normal, valid, system.output_names) if sound and np.all(np.isfinite(normal)) else None
    )


def split(normal: np.ndarray, valid: np.ndarray, outputs: Sequence[str]) -> Residuals:
    """Split normalised residuals ``(m, N, K)`` of K runs into misfit and noise."""
    runs = normal.shape[2]
    common = normal.mean(axis=2, keepdims=True)
    rest = np.where(valid[:, :, None], normal - common, 0.0) * (runs / (runs - 1.0)) ** 0.5
    variance = np.sum(rest**2, axis=(1, 2)) / np.maximum(runs * valid.sum(axis=1), 1)
    excess = np.where(valid, common[:, :, 0] ** 2 - variance[:, None] / runs, 0.0).sum() / max(
        valid.sum(), 1
    )
    # Subtract the mean square that noise alone leaves in K runs.
    excess *= excess > 4.0 * float(variance.mean()) * np.sqrt(2.0 / max(valid.sum(), 1)) / runs
    count = max(10, normal.shape[1] // 5)
    lags = np.array(
        [
            np.mean([autocovariance(rest[i, :, run], count) for run in range(runs)], axis=0)
            for i in range(len(rest))
        ]
    )
    lags *= normal.shape[1] / np.maximum(valid.sum(axis=1), 1)[:, None]
    colour = lags[:, 1] / np.maximum(lags[:, 0], 1e-300)
    return Residuals(
        float(np.sqrt(max(excess, 0.0))),
        colour,
        1.0 / float(np.sqrt(runs * valid.sum(axis=1).min())),
        tuple(outputs),
        lags,
        valid,
        common[:, :, 0],
    )


# ---- Errors predicted without repeating runs


def predicted_by_prior(bound: Bound, at: int) -> tuple[float, float]:
    """Return the rms error (stated sigmas) predicted from the priors, and the prior's share."""
    stated = float(bound.stated[at])
    return float(np.hypot(bound.scatter[at], bound.pull[at])) / stated, float(bound.prior_share[at])


def predicted_by_colour(bound: Bound, residuals: Residuals) -> np.ndarray | None:
    """Return the correction ``(n,)`` of the stated sigmas for coloured noise; None if unknown.

    The sandwich of Morelli and Klein (J. Guidance 20(1), 1997) with slopes at the reference and the
    mean correlation of the runs.
    """
    if bound.slopes is None:
        return None
    n, (m, count) = len(bound.names), residuals.valid.shape
    slopes = np.zeros((m * count, n))
    slopes[residuals.valid.ravel()] = bound.slopes[: int(residuals.valid.sum())]
    lags = residuals.lags.shape[1]
    taper = 1.0 - np.arange(lags) / lags
    coloured = np.zeros((n, n))
    for part, found in zip(slopes.reshape(m, count, n), residuals.lags, strict=True):
        coloured += filtered_product(part, found / found[0] * taper)
    white = bound.slopes.T @ bound.slopes
    variance = bound.stated**2 + np.diag(bound.gain @ (coloured - white) @ bound.gain.T)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / bound.stated)


# ---- First runs of a campaign repeated with a changed method

TRIALS_RUNS, TRIALS_ALONE = 64, 12  # runs repeated: batched methods, other methods
# Additional passes, each started from the previous result with this multiple of its sigmas.
FURTHER, SPREAD = 3, 20.0
REDUCED_NOISE_SHARE = 0.1
FILTER_STEPS_PER_SAMPLE = 4  # in the trial with finer steps

START, TRIALS_STEPS, LEVELS = "start", "steps", "levels"


@dataclass(frozen=True, eq=False)
class Trial:
    """Runs with the changes ``keys``: errors and reported sigmas ``(n, K)`` of converged runs."""

    keys: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray

    def rms(self, at: int) -> float:
        """Return the root mean square of a parameter's errors in reported sigmas."""
        return float(np.sqrt(np.mean((self.errors[at] / self.std[at]) ** 2)))

    def right(self, at: int) -> bool:
        """Return whether the rms error is consistent with correct sigmas (99.9 %)."""
        low, high = mean_square_interval(self.errors.shape[1], 0.999)
        return low <= self.rms(at) ** 2 <= high


@dataclass(frozen=True, eq=False)
class Trials:
    """First runs of a campaign, unchanged and with sets of changes; each set is computed once.

    ``done``: trials by their changes. ``scale``: ``(n,)``, factors on the reported sigmas for
    coloured noise.
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
        """Try the changes on the first sound runs."""
        work = campaign.work
        many = is_batched(campaign.estimation, bool(campaign.scenario.flight.feedback))
        seeds = tuple(
            int(seed)
            for seed in campaign.seeds[campaign.kept][: TRIALS_RUNS if many else TRIALS_ALONE]
        )
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
            found = self.work.estimated(estimation, records)
        except FlightidError:
            return None
        order = [found.names.index(name) for name in self.names]
        values = found.values[order]
        std = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2).T[order], 0.0))
        sound = np.array([outcome == SOUND for outcome in found.outcomes]) & np.all(
            np.isfinite(values) & (std > 0.0), axis=0
        )
        if 2 * np.sum(sound) < len(self.seeds):
            return None
        return Trial(
            keys, values[:, sound] - self.reference[:, None], self.scale[:, None] * std[:, sound]
        )


def _changes(
    work: EstimatorRuns, levels: Levels | None, reference: np.ndarray
) -> Mapping[str, Estimation]:
    """Return the possible changes of a method, each as the estimation with it."""
    estimation = work.estimation
    if estimation.method == "equation-error":
        return {}
    out = {}
    if estimation.method in FILTERS:
        out[START] = replace(
            estimation, passes=estimation.passes + FURTHER, spread=min(estimation.spread, SPREAD)
        )
        step = 1.0 / (FILTER_STEPS_PER_SAMPLE * work.seen.flight.rate)
        if (
            estimation.integration != "rk4"
            or 0 < estimation.terms < 3
            or min(estimation.max_step, FILTER_STEPS_PER_SAMPLE * step) > 0.02
        ):
            out[TRIALS_STEPS] = replace(
                estimation, integration="rk4", terms=3, max_step=min(estimation.max_step, step)
            )
        if levels is not None and levels.estimation is not None and not levels.agree:
            out[LEVELS] = levels.estimation
        return out
    truth = dict(zip(work.parameters, reference.tolist(), strict=True))
    out[START] = replace(
        estimation,
        start={
            name: Start(truth.get(name, start.value), start.std)
            for name, start in estimation.start.items()
        },
    )
    finer = (
        min(estimation.max_step, 0.01) / FILTER_STEPS_PER_SAMPLE
        if math.isfinite(estimation.max_step)
        else 0.01 / FILTER_STEPS_PER_SAMPLE
    )
    return (
        out
        if estimation.own is not None
        else {**out, TRIALS_STEPS: replace(estimation, max_step=finer)}
    )


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
    """Return the smallest set of changes that corrects the sigma, by index of the parameter."""
    out: dict[int, Trial] = {}
    first = trials.trial(())
    for keys in trials.subsets:
        if len(out) == len(at):
            break
        trial = trials.trial(keys)
        if trial is not None:
            # The scale for coloured noise may be enough without any change.
            out |= {
                one: trial
                for one in at
                if one not in out and trial.right(one) and (not keys or _nearer(trial, first, one))
            }
    return out


def _nearer(trial: Trial, first: Trial | None, at: int) -> bool:
    """Return whether a change at least halves the error of the sigma.

    With few runs, a nearly correct sigma passes the test even without the change.
    """
    return first is None or abs(math.log(trial.rms(at))) < 0.5 * abs(math.log(first.rms(at)))


def quiet_trial(trials: Trials) -> Trial | None:
    """Return the runs with a tenth of the noise.

    In sigmas, a bias caused by noise becomes a tenth, any other bias ten times as large.
    """
    work = trials.work
    noise = {
        name: REDUCED_NOISE_SHARE * value
        for name, value in work.common.truth.noise_std.items()
        if value > 0.0
    }
    told = {
        name: REDUCED_NOISE_SHARE * value
        for name, value in work.common.model.noise.measurement_std.items()
    }
    estimation = replace(work.estimation, flown_noise_std=noise, noise_std=told)
    quiet = EstimatorRuns(work.scenario, estimation)
    records = [quiet.record_of(seed) for seed in trials.seeds]
    return trials.of_records(("quiet",), estimation, records)
