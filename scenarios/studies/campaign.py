"""Monte-Carlo campaigns: the same flight measured many times, one seed a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import BankEstimate, run_bank
from ident.filters.ekf import SETTLED
from ident.statistics.shares import clopper_pearson, clustered_share
from scenarios.files.declarations import closest
from scenarios.studies.declaration import Estimation, Scenario, seen_by
from scenarios.studies.estimating import assumed_noise, compiled, declared_model, estimate_record, filter_settings, flight_constants
from scenarios.studies.flying import fly_scenario, measured_again
from scenarios.studies.study import references
from sim.declaration.model import Model
from sim.declaration.system import System
from sim.errors import DeclarationError, ModelError
from sim.record import Record
from sim.truth.flight import Truth, remeasure

RESAMPLING_SEED = 1  # of the interval over all parameters: the same runs give the same interval
FEWEST = 2  # runs, of which alone a scatter can be told
CHUNK = 500  # runs in one batch: enough to fill the vector units, little enough for the cache


@dataclass(frozen=True, eq=False)
class Spread:
    """One parameter over all runs.

    ``bias`` is mean error, ``scatter`` the standard deviation of the estimates, ``reported`` the root mean square of the
    estimator's own sigma, ``within_one`` and ``within_two`` the shares of its intervals that hold the reference, ``interval`` the latter's
    95 % confidence interval: of one parameter that of Clopper and Pearson over runs, of all together by resampling whole runs.
    """

    name: str
    unit: str
    reference: float
    bias: float
    scatter: float
    reported: float
    within_one: float
    within_two: float
    interval: tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """Results of N runs: estimates and sigmas ``(n, N)``, and their summary.

    ``broken`` runs are left out of it; ``asked`` is how many runs it was to be.
    """

    scenario: Scenario
    estimation: Estimation
    seeds: range
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    broken: int
    spreads: tuple[Spread, ...]
    pooled: Spread
    asked: int

    def __repr__(self) -> str:
        return f"<Campaign of {self.scenario.name}: {len(self.seeds)} runs by {self.estimation.name}>"


Progress = Callable[[str, float], None]
Piece = tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]  # names, estimates and sigmas (n, k), and which of the runs are sound (k,)


def fly_campaign(
    scenario: Scenario, runs: int, seed: int | None = None, method: str = "main", progress: Progress = lambda stage, share: None
) -> Campaign:
    """Run one of a scenario's estimations with ``runs`` seeds from ``seed`` on; run i equals ``flightid run --seed``.

    Filters run as one batch; whole-record fits one after the other. Where process noise really acts or measured outputs are
    fed back every run is flown anew, else the same flight is measured again. Ctrl-C ends it with the runs that had been estimated, if
    these are enough: ``asked`` then is more than there are seeds.

    Raises
    ------
    FlightidError : there is no method of that name, or what it declares cannot be flown or estimated.
    """
    first = scenario.seed if seed is None else seed
    known = {estimation.name: estimation for estimation in scenario.estimations}
    if method not in known:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=closest(method, known))
    estimation = known[method]
    scenario = seen_by(scenario, estimation)
    record, truth = fly_scenario(scenario, first)
    model = declared_model(estimation, flight_constants(scenario.flight, estimation), assumed_noise(scenario, estimation))
    # A batch has one input, and under feedback no two runs have the same.
    estimated, size = (_bank, CHUNK) if estimation.method == "ekf" and not scenario.flight.feedback else (_one, 1)
    pieces: list[Piece] = []
    try:
        for start in range(first, first + runs, size):
            progress(f"{start - first} of {runs} runs", (start - first) / runs)
            part = range(start, min(start + size, first + runs))
            pieces.append(estimated(estimation, [_record(scenario, estimation, record, truth, s) for s in part], model))
    except KeyboardInterrupt:
        if sum(len(sound) for *_, sound in pieces) < FEWEST:
            raise
    names = pieces[0][0]
    values, std, sound = (np.concatenate([piece[k] for piece in pieces], axis=-1) for k in (1, 2, 3))
    done = len(sound)
    reference = {item.name: item.value for item in truth.parameters}
    reference |= references(scenario, estimation)
    units = {item.name: item.unit for item in model.parameters}
    if np.sum(sound) < 2:
        what = f"{np.sum(~sound)} of {done} runs broke down"
        raise ModelError(what, where=f"estimation {estimation.name}", remedy="give it other starting values, or a flight that tells more")
    values, std = values[:, sound], std[:, sound]
    spreads = tuple(_spread(name, units[name], reference[name], values[i], std[i]) for i, name in enumerate(names))
    pooled = _pooled((values - np.array([[reference[name]] for name in names])) / std)
    return Campaign(scenario, estimation, range(first, first + done), names, values, std, int(np.sum(~sound)), spreads, pooled, runs)


def _record(scenario: Scenario, estimation: Estimation, record: Record, truth: Truth, seed: int) -> Record:
    if scenario.flight.process_noise or scenario.flight.feedback:
        record, truth = fly_scenario(scenario, seed)
        return measured_again(record, truth, estimation.flown_noise_std, seed) if estimation.flown_noise_std else record
    if estimation.flown_noise_std:
        return measured_again(record, truth, estimation.flown_noise_std, seed)
    return remeasure(record, truth, np.random.default_rng(seed))


def _one(estimation: Estimation, records: Sequence[Record], model: Model) -> Piece:
    """One run by a method that takes one record at a time."""
    found = estimate_record(estimation, records[0], model).estimate
    return found.names, np.array([found.values]).T, np.array([found.std]).T, np.array([found.outcome.code == "converged"])


def _bank(estimation: Estimation, records: Sequence[Record], model: Model) -> Piece:
    """Filters of many runs as one batch."""
    system, settings = compiled(estimation, model), filter_settings(estimation)
    z = np.stack([each.output_array(system.output_names)[0] for each in records], axis=2)
    n_x = len(system.states)
    if math.isinf(estimation.spread):
        bank = run_bank(records[0], system, settings, z=z)
        return bank.names[n_x:], bank.mean[n_x:], bank.std[n_x:], bank.sound
    bank = run_bank(records[0], system, replace(settings, passes=1), z=z)
    return bank.names[n_x:], *_narrowed_passes(estimation, records[0], system, bank, z)


def _narrowed_passes(
    estimation: Estimation, record: Record, system: System, bank: BankEstimate, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, sigmas and soundness after further passes, each run started and narrowed by its own result, as `studies.estimating` does."""
    settings, n_x = replace(filter_settings(estimation), passes=1), len(system.states)
    declared = np.array([*(item.prior_std for item in system.initial), *(system.parameters[name].prior_std for name in bank.names[n_x:])])
    first = np.array(system.initial.values())
    mean, std, sound = bank.mean[n_x:].copy(), bank.std[n_x:].copy(), bank.sound.copy()
    active = np.flatnonzero(sound)
    for _ in range(1, estimation.passes):
        if active.size == 0:
            break
        prior = np.repeat(declared[:, None], active.size, axis=1)
        prior[n_x:] = np.minimum(prior[n_x:], estimation.spread * std[:, active])
        start = np.concatenate([np.repeat(first[:, None], active.size, axis=1), mean[:, active]])
        covariance = prior.T[:, :, None] ** 2 * np.eye(len(declared))
        again = run_bank(record, system, settings, z=z[:, :, active], start=start, covariance=covariance)
        moved = np.max(np.abs(again.mean[n_x:] - mean[:, active]) / std[:, active], axis=0, initial=0.0)
        mean[:, active], std[:, active], sound[active] = again.mean[n_x:], again.std[n_x:], again.sound
        active = active[again.sound & (moved >= SETTLED)]
    return mean, std, sound


def _spread(name: str, unit: str, reference: float, values: np.ndarray, std: np.ndarray) -> Spread:
    """One parameter over runs ``(N,)``, which are independent of each other."""
    error = values - reference
    hits = int(np.sum(np.abs(error) <= 2.0 * std))
    scatter, reported = float(values.std(ddof=1)), float(np.sqrt(np.mean(std**2)))
    one = float(np.mean(np.abs(error) <= std))
    return Spread(name, unit, reference, float(error.mean()), scatter, reported, one, hits / len(values), clopper_pearson(hits, len(values)))


def _pooled(errors: np.ndarray) -> Spread:
    """All parameters together, from errors ``(n, N)`` in reported sigmas; those of one run are correlated."""
    hits = np.sum(np.abs(errors) <= 2.0, axis=0)
    interval = clustered_share(hits, np.full(len(hits), len(errors)), np.random.default_rng(RESAMPLING_SEED))
    one, two = float(np.mean(np.abs(errors) <= 1.0)), float(hits.sum()) / errors.size
    return Spread("all", "sigma", 0.0, float(errors.mean()), float(errors.std(ddof=1)), 1.0, one, two, interval)
