"""Monte-Carlo campaigns: the same flight measured many times, one seed a run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.bank import run_bank
from scenarios.declaration import Estimation, Scenario
from scenarios.estimating import compiled, declared_model, estimate_record, filter_settings, vehicle_constants
from scenarios.flying import fly_scenario
from scenarios.run import assumed_noise
from sim.record import Record
from sim.truth import Truth, remeasure
from sim.vehicles.condensation import condense
from sim.vehicles.library import read_parameter_set

CHUNK = 500  # runs in one batch: enough to fill the vector units, little enough for the cache


@dataclass(frozen=True, eq=False)
class Spread:
    """One parameter over all runs.

    ``bias`` is mean error, ``scatter`` the standard deviation of the estimates, ``reported`` the root mean square of the
    estimator's own sigma, ``within_two`` the share of 2-sigma intervals that hold the reference, ``interval`` its
    95 % confidence interval (Wilson).
    """

    name: str
    unit: str
    reference: float
    bias: float
    scatter: float
    reported: float
    within_two: float
    interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Campaign:
    """Results of N runs: estimates and sigmas ``(n, N)``, and their summary. ``broken`` runs are left out of it."""

    scenario: Scenario
    estimation: Estimation
    seeds: range
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    broken: int
    spreads: tuple[Spread, ...]
    pooled: Spread


def fly_campaign(scenario: Scenario, runs: int, seed: int | None = None) -> Campaign:
    """Run a scenario's main estimation with ``runs`` seeds from ``seed`` on; run i equals ``flightid run --seed``.

    Filters run as one batch; whole-record fits one after the other. Where process noise really acts every run is
    flown anew, else the same flight is measured again.
    """
    first = scenario.seed if seed is None else seed
    estimation = scenario.estimations[0]
    record, truth = fly_scenario(scenario, first)
    records = [_record(scenario, record, truth, s) for s in range(first, first + runs)]
    model = declared_model(estimation, vehicle_constants(estimation, scenario.flight.vehicle), assumed_noise(scenario, estimation))
    if estimation.method == "ekf":
        names, values, std, sound = _bank(estimation, records, model)
    else:
        done = [estimate_record(estimation, each, model).estimate for each in records]
        names = done[0].names
        values, std = np.array([e.values for e in done]).T, np.array([e.std for e in done]).T
        sound = np.array([e.outcome.code == "converged" for e in done])
    reference = {item.name: item.value for item in truth.parameters}
    if scenario.condensed:
        reference |= condense(read_parameter_set(scenario.flight.vehicle).values, scenario.flight.modes).derivatives
    units = {item.name: item.unit for item in model.parameters}
    values, std = values[:, sound], std[:, sound]
    spreads = tuple(_spread(name, units[name], reference[name], values[i], std[i]) for i, name in enumerate(names))
    errors = (values - np.array([[reference[name]] for name in names])) / std
    pooled = _spread("all", "sigma", 0.0, errors.ravel(), np.ones(errors.size))
    return Campaign(scenario, estimation, range(first, first + runs), names, values, std, int(np.sum(~sound)), spreads, pooled)


def wilson(hits: int, total: int) -> tuple[float, float]:
    """95 % confidence interval of a share (Wilson, JASA 22, 1927)."""
    if total == 0:
        return 0.0, 1.0
    z, share = 1.959964, hits / total
    centre = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * math.sqrt(share * (1 - share) / total + z * z / (4 * total**2)) / (1 + z * z / total)
    return max(0.0, centre - half), min(1.0, centre + half)


def _record(scenario: Scenario, record: Record, truth: Truth, seed: int) -> Record:
    if scenario.flight.process_noise:
        return fly_scenario(scenario, seed)[0]
    return remeasure(record, truth, np.random.default_rng(seed))


def _bank(estimation: Estimation, records: list[Record], model):  # type: ignore[no-untyped-def]
    system, settings = compiled(estimation, model), filter_settings(estimation)
    means, stds, sounds = [], [], []
    for start in range(0, len(records), CHUNK):
        part = records[start : start + CHUNK]
        z = np.stack([each.output_array(system.output_names)[0] for each in part], axis=2)
        bank = run_bank(part[0], system, settings, z=z)
        n_x = len(system.states)
        names = bank.names[n_x:]
        means.append(bank.mean[n_x:])
        stds.append(bank.std[n_x:])
        sounds.append(bank.sound)
    return names, np.concatenate(means, axis=1), np.concatenate(stds, axis=1), np.concatenate(sounds)


def _spread(name: str, unit: str, reference: float, values: np.ndarray, std: np.ndarray) -> Spread:
    error = values - reference
    hits = int(np.sum(np.abs(error) <= 2.0 * std))
    return Spread(
        name,
        unit,
        reference,
        float(error.mean()),
        float(values.std(ddof=1)),
        float(np.sqrt(np.mean(std**2))),
        hits / len(values),
        wilson(hits, len(values)),
    )
