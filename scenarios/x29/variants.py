"""The same scenario flown or estimated with one thing changed, by a quick estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ident.estimate import Estimate
from scenarios.x29.declaration import LoopScenario, Variant
from scenarios.x29.estimating import free_simulation, rough, set_up
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
