"""A phugoid claimed for itself where what remains is not noise: where it is flown, and not where what is slow as well was flown instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest

from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.known_motion import motion_that_stands
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.sensor_path.sensor_drift import SensorDrift
from tests.tracing_problem import all_records, coloured, doublets, fit_of, planted, problem_of, root_of

PHUGOID, DRIFT = Phugoid(), SensorDrift("nz", "g", 5e-3)
RIVALS: tuple[Traceable, ...] = (DRIFT, SensorDrift("alpha", "rad", 5e-4), SpeedVariation())
AIRCRAFT = {"phugoid.speed_damping": 0.012, "phugoid.induced_drag": 4.0, "phugoid.trim_moment": 0.01}


def flown(effects: Sequence[Traceable], values: Sequence[Mapping[str, float]]) -> Flight:
    """Coloured records of 14 s, one for each of some values."""
    return all_records([coloured(planted(effects, each, seed, flight=doublets(14.0, 25.0)), seed) for seed, each in enumerate(values, start=1)])


@pytest.fixture(scope="module")
def phugoid() -> Flight:
    return flown([PHUGOID], [{**AIRCRAFT, "phugoid.attitude": attitude} for attitude in (0.06, -0.05, 0.05)])


def test_a_phugoid_under_coloured_residuals_is_claimed_and_named_before_what_does_as_well(phugoid: Flight) -> None:
    claimed, tried = motion_that_stands(phugoid, RIVALS, fit_of(problem_of(list(phugoid.records)), [PHUGOID]))
    assert claimed is not None and claimed.best.effect.name == PHUGOID.name and claimed.best.stands
    assert claimed.best.gain > phugoid.settings.accept and "each record's own" in claimed.best.why
    # An even change of speed is nearly the same over 14 s; a drift of one channel is not.
    assert "speed-variation" in [item.effect.name for item in claimed.others] and DRIFT.name in {item.effect.name for item in tried}
    assert DRIFT.name not in [item.effect.name for item in claimed.others]
    assert {PHUGOID.name, "speed-variation"} <= {name for item in claimed.sets for name in item.names}


def test_where_something_else_that_is_slow_was_flown_the_phugoid_is_not_claimed_and_that_stands_among_what_was_tried() -> None:
    flight = flown([DRIFT], [{"sensor-drift:nz.slope": slope} for slope in (0.03, -0.03, 0.025)])
    claimed, tried = motion_that_stands(flight, RIVALS, fit_of(problem_of(list(flight.records)), [PHUGOID]))
    assert claimed is None and [item.effect.name for item in tried if item.stands] == [DRIFT.name]


def test_nothing_is_claimed_where_there_is_only_colour_and_nothing_tried_where_no_record_may_have_it(phugoid: Flight) -> None:
    still = flown([], [{}, {}, {}])
    claimed, tried = motion_that_stands(still, RIVALS, fit_of(problem_of(list(still.records)), [PHUGOID]))
    assert claimed is None and not any(item.stands for item in tried)
    assert motion_that_stands(phugoid, RIVALS, root_of(phugoid)) == (None, [])
