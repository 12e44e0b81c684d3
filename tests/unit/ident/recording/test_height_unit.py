"""A height in feet or kilometres is told by gravity; falls in metres, whatever their drag, are left
alone.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ident.recording.inspection import inspect
from ident.recording.series import Certainty, Expectations, Kind, RecordFinding
from sim.record import Channel, Record
from tests.recorded_flight import altered, fall

CASES = Path(__file__).parents[5] / "shared" / "cases" / "altitude-units"
EXPECTED = Expectations(gravity=9.80665, scale_height=7160.0)
METRES = {"ft": 0.3048, "km": 1000.0, "cm": 0.01, "mm": 0.001}


def coast(rng: np.random.Generator, speed: float = 150.0, ballistic: float = 120.0) -> Record:
    """A body thrown upwards, through its highest point, in steps of a millisecond; noise of half a
    metre.
    """
    height, rate, rows = 900.0, speed, []
    for k in range(18_000):
        if k % 50 == 0:
            rows.append(height)
        rate += 1e-3 * (
            -9.80665 - 0.5 * 1.2 * math.exp(-height / 7160.0) * rate * abs(rate) / ballistic
        )
        height += 1e-3 * rate
    return Record(
        0.05 * np.arange(len(rows)),
        (),
        (Channel.of("altitude", "m", np.array(rows) + 0.5 * rng.standard_normal(len(rows))),),
    )


def units(record: Record) -> list[RecordFinding]:
    return [one for one in inspect(record, EXPECTED) if one.kind is Kind.UNIT]


@pytest.mark.parametrize("unit", METRES)
@pytest.mark.parametrize("seed", range(3))
def test_another_unit_is_certain_and_named(unit: str, seed: int) -> None:
    (one,) = units(altered(coast(np.random.default_rng(seed)), altitude=lambda h: h / METRES[unit]))
    assert one.certainty is Certainty.CERTAIN and one.sentence.startswith(f"is in {unit}, not in m")
    assert f"altitude [{unit}]" in one.remedy


@pytest.mark.parametrize("seed", range(5))
def test_metres_are_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert units(coast(rng, rng.uniform(20.0, 300.0), rng.uniform(30.0, 1000.0))) == []
    assert units(fall(rng, 10.0, rng.uniform(15.0, 35.0), rng.uniform(0.1, 10.0))) == []


def test_a_fall_at_terminal_speed_says_nothing_of_its_unit() -> None:
    time = np.arange(300) / 10.0
    steady = 3000.0 - 55.0 * time + 0.5 * np.random.default_rng(1).standard_normal(300)
    for factor in (1.0, 0.3048, 1000.0):
        assert units(Record(time, (), (Channel.of("altitude", "m", steady / factor),))) == []


@pytest.mark.parametrize(("name", "unit"), [("coast_feet", "ft"), ("fall_km", "km")])
def test_reported_records(name: str, unit: str) -> None:
    path = CASES / f"{name}.csv"
    if not path.is_file():
        pytest.skip("the reported records are not here")
    time, height = np.loadtxt(path, delimiter=",", skiprows=1).T
    (one,) = units(Record(time, (), (Channel.of("altitude", "m", height),)))
    assert one.sentence.startswith(f"is in {unit}")
