"""Many records of one scenario's flight, estimated in one batch: what its standard deviations are
worth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import run_bank
from scenarios.studies.declaration import Estimation, Scenario, seen_by
from scenarios.studies.estimating import (
    assumed_noise,
    compiled,
    declared_model,
    filter_settings,
    fly_scenario,
    vehicle_constants,
)
from scenarios.studies.study import references
from sim.truth.flight import remeasure


@dataclass(frozen=True, eq=False)
class Repeated:
    """Estimates and standard deviations ``(n, runs)`` of ``names``; ``reference (n,)`` is what
    should be found.
    """

    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    reference: np.ndarray

    @property
    def sigmas(self) -> np.ndarray:
        """Errors in the estimator's own standard deviations, ``(n, runs)``."""
        return (self.estimate - self.reference[:, None]) / self.std

    def coverage(self, sigmas: float = 2.0) -> np.ndarray:
        """Share of the intervals of so many sigmas that hold the reference, ``(n,)``."""
        return np.mean(np.abs(self.sigmas) < sigmas, axis=1)


def repeat(scenario: Scenario, estimation: Estimation, seeds: Sequence[int]) -> Repeated:
    """Measure the scenario's flight with each seed and estimate; a narrowed further pass takes the
    batch's median sigma for all runs.
    """
    scenario = seen_by(scenario, estimation)
    record, truth = fly_scenario(scenario, seeds[0])
    truth = replace(truth, noise_std={**truth.noise_std, **estimation.flown_noise_std})
    model = declared_model(
        estimation,
        vehicle_constants(estimation, scenario.flight.vehicle),
        assumed_noise(scenario, estimation),
    )
    system = compiled(estimation, model)
    z = np.stack(
        [
            remeasure(record, truth, np.random.default_rng(seed)).output_array(system.output_names)[
                0
            ]
            for seed in seeds
        ],
        axis=2,
    )
    narrowing, n_x = np.isfinite(estimation.spread), len(system.states)
    settings = (
        replace(filter_settings(estimation), passes=1) if narrowing else filter_settings(estimation)
    )
    bank = run_bank(record, system, settings, z=z)
    for _ in range(1, estimation.passes if narrowing else 1):
        sigma: Mapping[str, float] = dict(
            zip(bank.names[n_x:], np.median(bank.std[n_x:], axis=1).tolist(), strict=True)
        )
        prior = {
            name: min(model.parameters[name].prior_std, estimation.spread * value)
            for name, value in sigma.items()
        }
        again = compiled(estimation, replace(model, parameters=model.parameters.with_prior(prior)))
        start = np.concatenate(
            [np.repeat(again.initial.values()[:, None], len(seeds), axis=1), bank.mean[n_x:]]
        )
        bank = run_bank(record, again, settings, z=z, start=start)
    assert np.all(bank.sound)
    found, names = references(scenario, estimation), bank.names[n_x:]
    reference = np.array([found.get(name, truth.parameters[name].value) for name in names])
    return Repeated(names, bank.mean[n_x:], bank.std[n_x:], reference)
