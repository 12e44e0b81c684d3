"""The same scenario flown or estimated with one thing changed: by a quick estimate, or with other seeds by the paper's bank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate
from scenarios.x29.declaration import LoopScenario, Variant
from scenarios.x29.estimating import free_simulation, plain, rough, set_up
from scenarios.x29.flying import fly_loop
from scenarios.x29.measures import Misfit, misfit, sensor_noise


@dataclass(frozen=True, eq=False)
class VariantResult:
    """A variant's name, label, quick estimate, delay and misfit."""

    name: str
    label: str
    estimate: Estimate
    delay: float
    misfit: Misfit


def run_variant(scenario: LoopScenario, variant: Variant, seed: int, start: Mapping[str, float]) -> VariantResult:
    """Fly a variant with a seed and estimate it; ``start`` is the scenario's, where the variant declares none."""
    flown = fly_loop(variant.flight, seed)
    setting = set_up(variant.estimation, flown, variant.estimation.start or start)
    estimate, delay = rough(setting)
    simulated = free_simulation(setting, estimate, delay)
    measured = misfit(setting.record, simulated, estimate, sensor_noise(flown), scenario.stretch, scenario.peak)
    return VariantResult(variant.name, variant.label, estimate, delay, measured)


@dataclass(frozen=True, eq=False)
class OverSeeds:
    """The paper's bank on flights that differ in their noise alone.

    Attributes
    ----------
    seeds : ``(k,)``. delays : the most likely delay of each, s. names : of the parameters.
    values : ``(k, n)`` parameters of the filter at that delay.
    """

    seeds: tuple[int, ...]
    delays: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray

    def by_delay(self) -> list[tuple[float, np.ndarray]]:
        """Each delay that was chosen, with the rows ``(j, n)`` of the flights that chose it; the most frequent first."""
        chosen = [(float(delay), self.values[self.delays == delay]) for delay in np.unique(self.delays)]
        return sorted(chosen, key=lambda each: -len(each[1]))


def run_over_seeds(scenario: LoopScenario, start: Mapping[str, float], prior: str) -> OverSeeds | None:
    """The paper's bank with the seeds 1 to ``scenario.seeds``; ``prior`` is its rule for P0. None where no seeds are asked for."""
    if not scenario.seeds:
        return None
    seeds = tuple(range(1, scenario.seeds + 1))
    found = [plain(set_up(scenario.estimation, fly_loop(scenario.flight, seed), start, prior=prior)) for seed in seeds]
    delays = np.array([round(each.delay, 6) for each in found])
    return OverSeeds(seeds, delays, found[0].estimate.names, np.array([each.estimate.values for each in found]))
