"""What is done about the raw columns: refused, warned of, set aside, or taken as they are."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ident.recording.series import Expectations
from scenarios.files.writing import json_text
from scenarios.preparation.plan import Plan
from scenarios.preparation.recording import (
    checked_records,
    expectations_of,
    joined,
    record_content,
    record_lines,
    record_table,
)
from sim.errors import RecordError
from sim.record import Record
from sim.vehicles.factory import model_from_constants
from tests.recorded_flight import Aircraft, altered, flight

EXPECTED = Aircraft().expected


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(31))


def repeating(values: np.ndarray) -> np.ndarray:
    return np.asarray(values[4 * (np.arange(len(values)) // 4)])


def test_a_sound_record_comes_back_itself(sound: Record) -> None:
    (same,), look = checked_records([sound], EXPECTED, Plan())
    assert same is sound and not look.seen and not look.doubts and not record_lines(look)
    assert record_content(look) == {
        "looked_at": ["flight.csv"],
        "trusted": False,
        "findings": [],
        "masked": {},
    }


def test_held_samples_are_set_aside_and_counted(sound: Record) -> None:
    held = altered(sound, alpha=repeating)
    (ready,), look = checked_records([held], EXPECTED, Plan())
    assert np.array_equal(np.flatnonzero(ready["alpha"].valid), np.arange(0, len(sound), 4))
    assert ready["q"] is held["q"] and ready.time is not None
    masked = len(sound) - len(np.arange(0, len(sound), 4))
    content = record_content(look)
    assert content["masked"] == {"flight.csv": {"alpha": masked}}
    assert content["findings"][0]["numbers"]["period"] == {
        "value": pytest.approx(0.08),
        "unit": "s",
    }
    (line,) = record_lines(look)
    assert line.startswith(
        "record: flight.csv: alpha is updated every 4 samples (12.5 Hz)"
    ) and line.endswith("set aside")
    assert record_table(look).rows[0][-2:] == ("throughout", f"{masked} samples set aside")


def test_a_filter_is_given_lines_between_updates(sound: Record) -> None:
    (ready,), look = checked_records([altered(sound, alpha=repeating)], EXPECTED, Plan(lowpass=5.0))
    fresh = np.arange(0, len(sound), 4)
    assert np.all(ready["alpha"].valid)
    assert np.allclose(
        ready["alpha"].values,
        np.interp(sound.time, sound.time[fresh], sound["alpha"].values[fresh]),
    )
    assert "straight lines" in look.lines[0]


def test_a_certain_fault_is_refused_with_its_remedy_in_one_line(sound: Record) -> None:
    with pytest.raises(
        RecordError,
        match=(
            r"flight.csv, channel nz: has the sign turned: .*; turn the sign of the column of nz "
            r"\(--trust-record"
        ),
    ) as caught:
        checked_records([sound, altered(sound, nz=np.negative)], EXPECTED, Plan())
    assert "\n" not in str(caught.value)


def test_a_record_that_is_trusted_is_warned_of_and_left_whole(sound: Record) -> None:
    faulty = altered(sound, nz=np.negative, alpha=repeating)
    (same,), look = checked_records([faulty], EXPECTED, Plan(trusted=True))
    assert same is faulty and look.trusted and len(look.doubts) == 2 and not look.lines
    content = record_content(look)
    assert content["trusted"] is True and content["masked"] == {}
    assert {one["done"] for one in content["findings"]} == {"a warning"}


def test_a_likely_fault_is_a_warning(sound: Record) -> None:
    (same,), look = checked_records(
        [altered(sound, alpha=lambda v: v + 0.03 * (np.arange(len(v)) > 430))], EXPECTED, Plan()
    )
    assert np.all(same["alpha"].valid)
    (doubt,) = look.doubts
    assert doubt.startswith("flight.csv: alpha jumps by 1.") and "as segments" in doubt


def test_the_content_is_strict_json(sound: Record) -> None:
    faulty = altered(
        sound, alpha=repeating, q=lambda v: np.where(np.arange(len(v)) % 97 == 5, -999.0, v)
    )
    _, look = checked_records([faulty], EXPECTED, Plan())
    read = json.loads(json_text(record_content(joined([look, look], trusted=False))))
    assert read["looked_at"] == ["flight.csv"] and len(read["findings"]) == 4
    for one in read["findings"]:
        assert {
            "record",
            "channel",
            "kind",
            "certainty",
            "times",
            "numbers",
            "masked",
            "done",
            "sentence",
        } <= set(one)
        assert one["certainty"] in ("certain", "likely", "costs information", "noted")


def test_what_a_model_lets_one_expect() -> None:
    constants = {
        "mass": 1500.0,
        "wing_area": 16.0,
        "chord": 1.5,
        "pitch_inertia": 2500.0,
        "airspeed": 110.0,
        "air_density": 1.0,
    }
    derivatives = {
        "CL_alpha": 2.0,
        "CL_q": 3.0,
        "CL_de": 0.1,
        "Cm_alpha": -0.1,
        "Cm_q": -3.0,
        "Cm_de": -0.12,
    }
    rigid = expectations_of(model_from_constants("rigid", constants, derivatives))
    power = 0.5 * 110.0**2 * 16.0 * 1.5 / 2500.0 * -0.12
    assert rigid.control_power == pytest.approx(power)
    assert rigid.airspeed == 110.0 and rigid.angular_control
    falling = {"air_density_reference": 1.225, "density_scale_height": 7160.0, "gravity": 9.79}
    body = expectations_of(model_from_constants("ballistic", falling, {"beta": 400.0}))
    assert body == Expectations(None, 9.79, scale_height=7160.0)
