"""The airspeed that a measured dynamic pressure gives to a check."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.compatibility.trials import SensorFinding
from scenarios.compatibility import _with_speed
from scenarios.compatibility_report import fault_text, sentence
from sim.record import Channel, Record

TIME = np.arange(4) * 0.1
SPEED = np.array([40.0, np.nan, 55.0, 0.0])
AIR: Any = SimpleNamespace(constants={"air_density": 0.9})


def record_of(**channels: np.ndarray) -> Record:
    units = {"dynamic_pressure": "Pa", "airspeed": "m/s", "q": "rad/s"}
    outputs = tuple(Channel.of(name, units[name], values) for name, values in channels.items())
    return Record(TIME, (), outputs, name="r.csv")


def test_the_airspeed_is_that_of_half_rho_v_squared() -> None:
    pressure = 0.5 * 0.9 * SPEED**2
    made, said = _with_speed(record_of(q=np.zeros(4), dynamic_pressure=pressure), AIR)
    assert made.output_names == ("q", "airspeed") and "air of 0.9 kg/m3" in said
    assert made["airspeed"].with_gaps() == pytest.approx(SPEED, nan_ok=True)
    # A pressure below zero is an error of the sensor at rest.
    below, _ = _with_speed(record_of(dynamic_pressure=np.full(4, -5.0)), AIR)
    assert np.all(below["airspeed"].values == 0.0)


def test_a_recorded_airspeed_is_kept_and_without_a_density_none_is_made() -> None:
    both = record_of(airspeed=np.full(4, 50.0), dynamic_pressure=np.full(4, 900.0))
    made, said = _with_speed(both, AIR)
    assert made.output_names == ("airspeed",) and made["airspeed"].values[0] == 50.0 and said == ""
    alone = record_of(q=np.zeros(4), dynamic_pressure=np.full(4, 900.0))
    for vehicle in (None, SimpleNamespace(constants={})):
        made, said = _with_speed(alone, vehicle)  # type: ignore[arg-type]
        assert made.output_names == ("q",) and said == ""
    bare = record_of(q=np.zeros(4))
    assert _with_speed(bare, AIR) == (bare, "")


def test_an_arm_is_told_by_its_side_and_a_confusable_fault_beside_it() -> None:
    behind = SensorFinding("nz", "arm", -9.14, 0.23, "m", 824.7, True, ("vane-offset",), "x")
    assert fault_text(behind) == "the accelerometer is 9.14 +- 0.23 m behind the centre of gravity"
    words = "(raises the log likelihood by 824.7; vane-offset fits these data equally well)"
    assert words in sentence(behind)
    ahead = replace(behind, channel="alpha", value=9.14, group=())
    assert fault_text(ahead) == "the vane is 9.14 +- 0.23 m ahead of the centre of gravity"
    assert sentence(ahead).endswith("(raises the log likelihood by 824.7)")
