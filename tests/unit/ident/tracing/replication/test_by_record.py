"""Does an effect come out alike from each record, and how are some of them fitted."""

from __future__ import annotations

import pytest

from ident.tracing.replication.by_record import Flight, replicate
from ident.whole_record.layout import FitSettings
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.sensor_path.sensor_delay import SensorDelay
from tests.tracing_problem import all_records, planted

LATE = SensorDelay("alpha")


def test_what_differs_from_record_to_record_does_not_replicate(late: Flight) -> None:
    """A delay in one record of three."""
    one = planted([LATE], {"sensor-delay:alpha.delay": 0.12}, 1)
    flight = all_records([one, planted([], None, 2), planted([], None, 3)])
    fitted = flight.fit((LATE,), range(3), None, {"sensor-delay:alpha.delay": 0.04})
    assert fitted is not None
    copies = replicate(flight, fitted, LATE)
    assert not copies.agrees
    assert [found["delay"].value for found in copies.values] == [pytest.approx(0.12, abs=0.01), *[pytest.approx(0.0, abs=0.01)] * 2]


def test_settings_for_replication_are_those_of_a_search() -> None:
    """A fit of a Flight is that of the engine at twice the declared step."""
    flight = all_records([planted([], None, 1)])
    fitted = flight.fit((), [0], None)
    assert fitted is not None and fitted.fit.layout.settings.max_step == FitSettings(max_step=0.04).max_step
    assert not any(isinstance(effect, GustDiscrete) for effect in fitted.effects)
