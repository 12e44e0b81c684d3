"""What the controls have moved tells a fault of a sensor from a gust."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.fitting import fit, instruments_of, projected_whitener
from ident.compatibility.signals import signals_of, whitener
from ident.compatibility.trials import Compatibility, CompatibilitySettings
from sim.record import Channel, Record
from tests.oracles import undeclared_flights as flights
from tests.oracles.undeclared_flights import TRAINER
from tests.unit.ident.compatibility.flights import THREE, in_rough_air, record


def checked(records: list[Record]) -> Compatibility:
    return compatibility(records, CompatibilitySettings(TRAINER.airspeed))


def test_the_weighed_part_is_a_projection_of_what_is_white() -> None:
    one = in_rough_air(0)
    s = replace(signals_of(one, THREE, TRAINER.airspeed, 9.80665), instruments=instruments_of(one))
    noise = fit([s]).noise
    x = np.where(s.valid, np.random.default_rng(1).standard_normal(s.valid.shape), 0.0)[:, :, None]
    part, whole = projected_whitener(s, noise)(x), whitener(s, noise)(x)
    assert float(np.sum(part * (whole - part))) == pytest.approx(
        0.0, abs=1e-9 * float(np.sum(whole**2))
    )
    moved = s.instruments[:, [4]].T[:, :, None] * s.valid[:, :, None]
    assert projected_whitener(s, noise)(moved) == pytest.approx(
        whitener(s, noise)(moved), abs=1e-6 * float(np.abs(whitener(s, noise)(moved)).max())
    )


def test_without_a_control_that_moves_there_are_none() -> None:
    still = Channel.of("elevator", "rad", np.full(len(record()), 0.1))
    assert (
        instruments_of(record()).shape[1] == 0
        and instruments_of(replace(record(), inputs=(still,))).shape[1] == 0
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "sensor", "value"),
    [
        ("sensor-delay:alpha", {"alpha": flights.shown_late(0.08)}, 0.08),
        ("sensor-delay:q", {"q": flights.shown_late(0.08)}, 0.08),
        # a load ahead of its time looks so
        ("sensor-scale:alpha", {"alpha": flights.scaled(1.25)}, 1.25),
    ],
)
def test_a_fault_shows_in_rough_air_in_its_size(
    name: str, sensor: dict[str, flights.Sensor], value: float
) -> None:
    found = checked([in_rough_air(0, sensors=sensor)])
    (fault,) = [each for each in found.findings if each.name == name]
    assert fault.supported and abs(fault.value - value) < 3.0 * fault.std


@pytest.mark.long
def test_rough_air_alone_accuses_no_sensor() -> None:
    for seed in (2, 3):
        assert not [each.name for each in checked([in_rough_air(seed)]).findings if each.supported]
