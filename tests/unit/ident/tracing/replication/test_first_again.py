"""What was chosen first stood for two causes: asked again with the other in the model."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect
from ident.tracing.replication.cross_validation import cross_validate
from ident.tracing.replication.first_again import first_again
from ident.tracing.replication.one_round import Tried, weigh_all
from sim.declaration.proposal import Traceable
from sim.effects.input_path.actuator_lag import ActuatorLag
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import all_records, coloured, planted, root_of

SLOW, ALPHA, Q = ActuatorLag("elevator"), SensorLag("alpha"), SensorLag("q")
TWO_LATE = {"sensor-lag:alpha.time_constant": 0.09, "sensor-lag:q.time_constant": 0.045}


@pytest.fixture(scope="module")
def two_late() -> Flight:
    """Three coloured records with alpha and q late, which an actuator that lags and a lag of alpha nearly explain."""
    return all_records([coloured(planted([ALPHA, Q], TWO_LATE, seed), seed) for seed in (1, 2, 3)])


def one_after_the_other(flight: Flight, *effects: Traceable) -> tuple[Tried, list[CrossValidatedEffect]]:
    """Rounds in which nothing else is offered, and what each tries is taken."""
    fitted, rounds, found = root_of(flight), list[Tried](), list[CrossValidatedEffect]()
    for effect in effects:
        step = weigh_all(flight, [effect], fitted)
        assert step is not None
        rounds.append(step)
        found.append(CrossValidatedEffect(step.results[0], ()))
        fitted = step.results[0].fitted
    return rounds[0], found


def names(found: Sequence[CrossValidatedEffect]) -> list[str]:
    return [item.best.effect.name for item in found]


def test_a_late_rate_takes_the_place_of_the_actuator_beside_a_late_angle(two_late: Flight) -> None:
    first, found = one_after_the_other(two_late, SLOW, ALPHA)
    again, tried = first_again(two_late, [SLOW, ALPHA, Q], first, found)
    assert names(again) == ["sensor-lag:q", "sensor-lag:alpha"] and {item.effect.name for item in tried} >= {"sensor-lag:q", "actuator-lag"}
    # Each with the other in the model, and no worse together than what they replace.
    assert [set(item.best.fitted.names) for item in again] == [{"sensor-lag:q", "sensor-lag:alpha"}] * 2
    assert again[-1].best.fitted.fit.cost < found[-1].best.fitted.fit.cost
    for name, value in TWO_LATE.items():
        assert again[-1].best.fitted.values.shared[name] == pytest.approx(value, abs=0.02)


def test_what_was_right_stays_and_gains_no_alternative_that_does_less(two_late: Flight) -> None:
    first, found = one_after_the_other(two_late, Q, ALPHA)
    again, _ = first_again(two_late, [SLOW, ALPHA, Q, SensorScale("nz")], first, found)
    assert names(again) == ["sensor-lag:q", "sensor-lag:alpha"] and again[1] is found[1]
    assert "sensor-scale:nz" not in {item.effect.name for item in again[0].others}


def test_one_alone_or_without_a_rival_is_not_asked(two_late: Flight) -> None:
    first, found = one_after_the_other(two_late, Q, ALPHA)
    assert first_again(two_late, [SLOW, ALPHA, Q], first, found[:1]) == (found[:1], [])
    assert first_again(two_late, [ALPHA, Q], first, found) == (found, [])


def test_two_late_channels_are_told_whatever_came_first(two_late: Flight) -> None:
    found, _ = cross_validate(two_late, [SLOW, ALPHA, Q], root_of(two_late))
    assert set(names(found)) == {"sensor-lag:q", "sensor-lag:alpha"}
