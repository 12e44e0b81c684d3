"""How often an effect is said to stand where nothing of the library is hidden: simulated flights whose residuals are coloured by other causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pytest

from ident.statistics.shares import clopper_pearson
from ident.tracing.loop import fit_declared, held_out_data
from ident.tracing.replication.partial import cross_validated
from ident.tracing.selection.criterion import is_white
from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for, guards_for
from sim.record import Channel, Record
from sim.truth.noise import coloured_noise
from sim.vehicles.short_period import ShortPeriod
from tests.bases import Flight, rigid_model
from tests.rigid_problem import FREE, noisy
from tests.tracing_problem import problem_of, with_output

FLIGHTS = 70
RECORDS = 5  # of each, the last of which is not fitted
NOISE = {"alpha": 0.002, "q": 0.002, "nz": 0.01}  # of the white part


@dataclass(frozen=True)
class CubicLoads:
    """moment += alpha^2 (``squared`` q_hat + ``mixed`` elevator) + ``steep`` elevator q_hat^2: neither in the library nor a guard."""

    name: ClassVar[str] = "own:cubic"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = tuple(Parameter(name, 1.0, "1/rad3") for name in ("squared", "mixed", "steep"))
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"squared": 0.0, "mixed": 0.0, "steep": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = "Three small terms of third order."

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        wing = p.squared * s.alpha_air**2 * s.q_hat + p.mixed * s.alpha_air**2 * s.elevator
        return {"moment": wing + p.steep * s.elevator * s.q_hat**2}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


def library() -> tuple[Traceable, ...]:
    equations = ShortPeriod()
    return (*(effect for effect in effects_for(equations) if isinstance(effect, Traceable)), *guards_for(equations))


def moves(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Steps of random size and length after a rest, 0.06 rad at most."""
    edges = np.concatenate([[1.0], 1.0 + np.cumsum(rng.uniform(0.3, 1.5, 40))])
    out = np.zeros(len(time))
    for begin, end in pairwise(edges):
        out[(time >= begin) & (time < end)] = rng.uniform(-0.06, 0.06)
    return out


def record(rng: np.random.Generator, terms: Mapping[str, float]) -> Record:
    """One record of an aircraft: 12 s at 25 Hz.

    Its derivatives are a few per cent off those of the others (mass, trim, speed), its surface does not quite follow what is recorded,
    and every channel has noise that remembers itself.
    """
    time = 0.04 * np.arange(301)
    recorded = moves(rng, time)
    surface = recorded + coloured_noise(rng, time, 0.0015, rng.uniform(0.2, 0.6))
    model = rigid_model().with_effects(CubicLoads())
    own = {name: model.parameters[name].value * (1.0 + 0.02 * rng.standard_normal()) for name in FREE}
    flown = noisy(model.with_values({**own, **terms}), Flight(time, surface[None], max_step=0.02), rng)
    for name, std in NOISE.items():
        flown = with_output(flown, name, flown[name].values + coloured_noise(rng, time, rng.uniform(0.5, 2.0) * std, rng.uniform(0.1, 1.0)))
    return replace(flown, inputs=(Channel.of("elevator", "rad", recorded),))


def claimed_on(seed: int) -> tuple[str, ...] | None:
    """Names that are said to stand on one flight; None where the declared model leaves noise, so that there is nothing to ask."""
    rng = np.random.default_rng((seed, 4))
    terms = {f"own:cubic.{name}": size * rng.standard_normal() for name, size in (("squared", 800.0), ("mixed", 8.0), ("steep", 1.2e4))}
    records = [record(rng, terms) for _ in range(RECORDS)]
    begun = fit_declared(replace(problem_of(records[:-1], library()), predicted=records[-1:]))
    if is_white(begun.root):
        return None
    _, partial = cross_validated(begun.ledger, begun.root, held_out_data(begun, records[-1:]))
    return () if partial is None else tuple(claim.name for claim in partial.claims)


@pytest.mark.slow
def test_hardly_anything_stands_where_nothing_of_the_library_is_hidden() -> None:
    """When this was written 2 of 100 flights (0.2 to 7.0 %), none of the first 80.

    With three fitted records instead of four it was 6 of 120 (1.9 to 10.6 %).
    """
    asked = [names for seed in range(FLIGHTS) if (names := claimed_on(seed)) is not None]
    assert len(asked) > 0.95 * FLIGHTS, "residuals are not coloured: no null of this"
    claims = [names for names in asked if names]
    assert len(claims) <= 0.05 * len(asked), claims
    assert clopper_pearson(len(claims), len(asked))[1] < 0.1
