"""The first runs of a campaign again with something of the method changed: what makes a wrong sigma right is its cause."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ident.statistics.intervals import mean_square_interval
from scenarios.studies.campaign import Campaign
from scenarios.studies.campaign_causes.levels import Levels
from scenarios.studies.campaign_statistics.bound import FILTERS
from scenarios.studies.declaration import Estimation, Start
from scenarios.studies.runs.batch import is_batched
from scenarios.studies.runs.work import SOUND, EstimatorRuns
from sim.errors import FlightidError
from sim.record import Record

RUNS, ALONE = 64, 12  # that are computed again: of a batch, of methods one by one
FURTHER, SPREAD = 3, 20.0  # passes more, each started at the result of the one before with a spread of so many of its sigmas
TENTH = 0.1
PART = 4  # steps of a sample, where a filter's are made finer

START, STEPS, LEVELS = "start", "steps", "levels"


@dataclass(frozen=True, eq=False)
class Trial:
    """Runs with the changes ``keys``: errors and reported sigmas ``(n, K)`` of those that settled."""

    keys: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray

    def rms(self, at: int) -> float:
        """Root mean square of a parameter's errors in reported sigmas."""
        return float(np.sqrt(np.mean((self.errors[at] / self.std[at]) ** 2)))

    def right(self, at: int) -> bool:
        """Whether that is what right sigmas give in 999 of 1000 trials."""
        low, high = mean_square_interval(self.errors.shape[1], 0.999)
        return low <= self.rms(at) ** 2 <= high


@dataclass(frozen=True, eq=False)
class Trials:
    """A campaign's first runs: as they were (no keys), and with each set of changes that is asked for, computed once.

    ``scale`` ``(n,)`` : by what reported sigmas are multiplied in all of them, for coloured noise.
    """

    work: EstimatorRuns
    names: tuple[str, ...]
    reference: np.ndarray
    seeds: tuple[int, ...]
    changes: Mapping[str, Estimation]
    done: dict[tuple[str, ...], Trial | None]
    scale: np.ndarray

    @classmethod
    def of(cls, campaign: Campaign, levels: Levels | None, scale: np.ndarray | None = None) -> Trials:
        """Of the first sound runs."""
        work = campaign.work
        many = is_batched(campaign.estimation, bool(campaign.scenario.flight.feedback))
        seeds = tuple(int(seed) for seed in campaign.seeds[campaign.kept][: RUNS if many else ALONE])
        reference = np.array([spread.reference for spread in campaign.spreads])
        return cls(work, campaign.names, reference, seeds, _changes(work, levels, reference), {}, np.ones(len(reference)) if scale is None else scale)

    @property
    def subsets(self) -> Iterator[tuple[str, ...]]:
        """Sets of changes, the smallest first."""
        for size in range(0 if np.any(self.scale != 1.0) else 1, len(self.changes) + 1):
            yield from combinations(self.changes, size)

    def trial(self, keys: tuple[str, ...]) -> Trial | None:
        """The runs with these changes; None where fewer than half of them settle."""
        if keys not in self.done:
            self.done[keys] = self._computed(keys)
        return self.done[keys]

    def _computed(self, keys: tuple[str, ...]) -> Trial | None:
        estimation = self.work.estimation
        for key in keys:
            estimation = _merged(estimation, self.changes[key], key)
        return self.of_records(keys, estimation, [self.work.record_of(seed) for seed in self.seeds])

    def of_records(self, keys: tuple[str, ...], estimation: Estimation, records: Sequence[Record]) -> Trial | None:
        """Records estimated by a changed method; None where fewer than half of them settle."""
        try:
            found = self.work.estimated(estimation, records)
        except FlightidError:
            return None
        order = [found.names.index(name) for name in self.names]
        values, std = found.values[order], np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2).T[order], 0.0))
        sound = np.array([outcome == SOUND for outcome in found.outcomes]) & np.all(np.isfinite(values) & (std > 0.0), axis=0)
        if 2 * np.sum(sound) < len(self.seeds):
            return None
        return Trial(keys, values[:, sound] - self.reference[:, None], self.scale[:, None] * std[:, sound])


def _changes(work: EstimatorRuns, levels: Levels | None, reference: np.ndarray) -> Mapping[str, Estimation]:
    """What can be changed of a method, each as the estimation with it."""
    estimation = work.estimation
    if estimation.method == "equation-error":
        return {}
    out = {}
    if estimation.method in FILTERS:
        out[START] = replace(estimation, passes=estimation.passes + FURTHER, spread=min(estimation.spread, SPREAD))
        step = 1.0 / (PART * work.seen.flight.rate)
        if estimation.integration != "rk4" or 0 < estimation.terms < 3 or min(estimation.max_step, PART * step) > 0.02:
            out[STEPS] = replace(estimation, integration="rk4", terms=3, max_step=min(estimation.max_step, step))
        if levels is not None and levels.estimation is not None and not levels.agree:
            out[LEVELS] = levels.estimation
        return out
    truth = dict(zip(work.parameters, reference.tolist(), strict=True))
    out[START] = replace(estimation, start={name: Start(truth.get(name, start.value), start.std) for name, start in estimation.start.items()})
    finer = min(estimation.max_step, 0.01) / PART if math.isfinite(estimation.max_step) else 0.01 / PART
    return out if estimation.own is not None else {**out, STEPS: replace(estimation, max_step=finer)}


def _merged(estimation: Estimation, changed: Estimation, key: str) -> Estimation:
    """An estimation with one change more."""
    if key == STEPS:
        return replace(estimation, integration=changed.integration, terms=changed.terms, max_step=changed.max_step)
    if key == LEVELS:
        return replace(estimation, noise_std=changed.noise_std, process_noise=changed.process_noise)
    return replace(estimation, passes=changed.passes, spread=changed.spread, start=changed.start)


def closest(trials: Trials, at: Sequence[int]) -> dict[int, Trial]:
    """For each parameter the smallest set of changes that makes its sigma right, where there is one."""
    out: dict[int, Trial] = {}
    first = trials.trial(())
    for keys in trials.subsets:
        if len(out) == len(at):
            break
        trial = trials.trial(keys)
        if trial is not None:
            # Beside a scale that is known already no change at all may be enough.
            out |= {one: trial for one in at if one not in out and trial.right(one) and (not keys or _nearer(trial, first, one))}
    return out


def _nearer(trial: Trial, first: Trial | None, at: int) -> bool:
    """Whether a change takes at least half of what is wrong away: few runs call right what is nearly so."""
    return first is None or abs(math.log(trial.rms(at))) < 0.5 * abs(math.log(first.rms(at)))


def quiet_trial(trials: Trials) -> Trial | None:
    """The runs with a tenth of the noise, all else as it is: a bias that noise makes is then a tenth in sigmas, any other ten times as large."""
    work = trials.work
    noise = {name: TENTH * value for name, value in work.common.truth.noise_std.items() if value > 0.0}
    told = {name: TENTH * value for name, value in work.common.model.noise.measurement_std.items()}
    estimation = replace(work.estimation, flown_noise_std=noise, noise_std=told)
    quiet = EstimatorRuns(work.scenario, estimation)
    records = [quiet.record_of(seed) for seed in trials.seeds]
    return trials.of_records(("quiet",), estimation, records)
