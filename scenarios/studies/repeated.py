"""A scenario's flights flown many times: how far each estimator's derivatives lie from the truth, in its own sigmas and in their units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.statistics.intervals import clustered_share
from scenarios.studies.declaration import Estimation, Scenario, Variation
from scenarios.studies.estimating import assumed_noise, declared_model, estimate_record, flight_constants
from scenarios.studies.flying import fly_scenario
from sim.record import Record
from sim.truth.flight import Truth

RESAMPLING_SEED = 1  # of the interval over all derivatives: the same runs give the same interval


@dataclass(frozen=True, eq=False)
class Scatter:
    """What one estimator made of one flight, flown N times.

    ``errors`` (estimate minus true) and ``std`` are ``(n, M)``, in the derivatives' units, of the M runs that settled; ``outcomes`` counts all N by
    code.
    """

    flight: str
    estimation: Estimation
    names: tuple[str, ...]
    units: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray
    outcomes: Mapping[str, int]

    @property
    def sigmas(self) -> np.ndarray:
        """Errors in the reported standard deviations ``(n, M)``."""
        return np.asarray(self.errors / self.std)

    @property
    def rms_sigmas(self) -> np.ndarray:
        """Root mean square of these by derivative ``(n,)``: one where the reported sigmas are right."""
        return np.sqrt(np.mean(self.sigmas**2, axis=1)) if self.errors.shape[1] else np.full(len(self.names), np.nan)

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error by derivative ``(n,)``, in its unit."""
        return np.sqrt(np.mean(self.errors**2, axis=1)) if self.errors.shape[1] else np.full(len(self.names), np.nan)

    @property
    def within_two(self) -> tuple[float, tuple[float, float]]:
        """Share of 2-sigma intervals that hold the truth, over all derivatives, and its 95 % interval by resampling whole runs."""
        hits = np.sum(np.abs(self.sigmas) <= 2.0, axis=0)
        share = float(hits.mean()) / len(self.names) if hits.size else 0.0
        return share, clustered_share(hits, np.full(len(hits), len(self.names)), np.random.default_rng(RESAMPLING_SEED)) if hits.size else (0.0, 1.0)


def fly_repeatedly(
    scenario: Scenario, seed: int | None = None, progress: Callable[[str, float], None] = lambda stage, share: None
) -> tuple[Scatter, ...]:
    """All repeated flights of a scenario, each estimated by the methods it names; run i has the seed ``seed + i``.

    Raises
    ------
    FlightidError : something is declared that cannot be flown or estimated.
    """
    if scenario.repeated is None:
        return ()
    first, runs, found = scenario.seed if seed is None else seed, scenario.repeated.runs, []
    parts = [(flight, estimation) for flight in scenario.repeated.flights for estimation in scenario.estimations if estimation.name in flight.methods]
    for number, (flight, estimation) in enumerate(parts):
        progress(f"{number + 1} of {len(parts)}, {flight.label}: {estimation.label}", number / len(parts))
        found.append(_scatter(scenario, flight, estimation, list(_flown(scenario, flight, first, runs))))
    return tuple(found)


def _flown(scenario: Scenario, variation: Variation, first: int, runs: int) -> Iterator[tuple[Record, Truth]]:
    for seed in range(first, first + runs):
        yield fly_scenario(replace(scenario, flight=variation.flight), seed)


def _scatter(scenario: Scenario, variation: Variation, estimation: Estimation, flown: list[tuple[Record, Truth]]) -> Scatter:
    model = declared_model(estimation, flight_constants(variation.flight, estimation), assumed_noise(scenario, estimation))
    names = tuple(estimation.start)
    own = replace(estimation, engine="batched")
    done = [estimate_record(own, record, model).estimate for record, _ in flown]
    true = np.array([[truth.parameters[name].value for name in names] for _, truth in flown])
    values = np.array([[estimate.value(name) for name in names] for estimate in done])
    std = np.array([[estimate.sigma(name) for name in names] for estimate in done])
    settled = np.array([estimate.outcome.code == "converged" for estimate in done])
    outcomes = Counter(estimate.outcome.code for estimate in done)
    units = tuple(model.parameters[name].unit for name in names)
    return Scatter(variation.label, estimation, names, units, (values - true)[settled].T, std[settled].T, dict(outcomes))
