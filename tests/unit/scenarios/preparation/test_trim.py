"""Inputs about their trim: what tells it, and what is said where nothing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.preparation.measured_inputs import about_trim, trim_sentence
from sim.record import Channel, Record
from tests.bases import Flight, rigid_flight
from tests.tracing_problem import planted

TIME = 0.05 * np.arange(200)
PULSES = np.where((TIME >= 2.0) & (TIME < 3.0), 0.04, 0.0) - np.where(
    (TIME >= 3.0) & (TIME < 4.0), 0.04, 0.0
)
SETTLING = np.exp(-TIME / 0.4)  # an aircraft that was not in trim when the recorder started


def record_of(elevator: np.ndarray, q: np.ndarray) -> Record:
    return Record(
        TIME,
        (Channel.of("elevator", "rad", elevator),),
        (Channel.of("q", "rad/s", q),),
        name="r.csv",
    )


@pytest.mark.parametrize("settling", [0.0, 1.0])
def test_an_input_that_rests_first_and_last_is_in_trim_though_the_aircraft_settles(
    settling: float,
) -> None:
    record, trims = about_trim(record_of(PULSES - 0.04, settling * SETTLING + 0.1 * PULSES))
    assert trims == pytest.approx({"elevator": -0.04}) and np.allclose(
        record["elevator"].values, PULSES
    )
    assert trim_sentence(record, "elevator") == ""


def test_a_sample_that_is_on_its_way_to_the_first_move_is_no_rest() -> None:
    """A surface that the recorder caught at the begin of its move, within a twentieth of the
    span.
    """
    moving = PULSES - 0.04
    moving[np.flatnonzero(PULSES)[0] - 1] += 0.003
    record, trims = about_trim(record_of(moving, 0.1 * PULSES))
    assert trims == {"elevator": pytest.approx(-0.04, abs=1e-12)}
    assert np.max(np.abs(record["elevator"].values[:39])) < 1e-12


def test_a_maneuver_that_begins_with_the_record_has_no_trim() -> None:
    step = np.where(TIME < 1.0, 0.04, np.where(TIME < 2.0, -0.04, 0.0))
    record = record_of(step, np.minimum(TIME, 1.0))
    assert about_trim(record) == (record, {}) and trim_sentence(record, "elevator") == ""


def test_an_unknown_trim_is_told_where_it_matters() -> None:
    ramp = -0.04 + 0.02 * np.sin(2.0 * TIME)
    record, trims = about_trim(record_of(ramp, np.sin(2.0 * TIME)))
    assert not trims
    assert trim_sentence(record, "elevator").startswith(
        "r.csv: no rest of the elevator at the beginning tells its trim; its zero is taken"
    )
    assert trim_sentence(record_of(ramp + 0.04, ramp), "elevator") == ""


def test_a_sum_of_sines_that_begins_gently_is_no_rest() -> None:
    """Its first half second stays within a twentieth of its span and has a mean; noise on an input
    that rests has one as well, and is one.
    """
    rise = np.minimum(TIME / 2.0, 1.0)
    gentle = 0.1 * rise * np.sin(3.0 * TIME + 1.0)
    record = record_of(gentle, np.sin(TIME))
    assert about_trim(record) == (record, {})
    noise = 0.0005 * np.random.default_rng(1).standard_normal(len(TIME))
    resting = record_of(PULSES - 0.01 + noise, PULSES)
    assert about_trim(resting)[1] == pytest.approx(
        {"elevator": -0.01}, abs=4.0 * 0.0005 / np.sqrt(39.0)
    )


def test_a_record_of_an_aircraft_about_its_trim() -> None:
    """A rest before the first move is a trim; a step that is held from the first sample on is
    none.
    """
    flight = rigid_flight(8.0, 50.0)
    waiting = Flight(flight.time, np.where(flight.time < 1.0, 0.0, flight.u), max_step=0.02)
    record = planted([], None, 1, flight=waiting)
    assert about_trim(record) == (record, {})
    shifted = replace(
        record, inputs=tuple(replace(c, values=c.values + 0.02) for c in record.inputs)
    )
    moved, trims = about_trim(shifted)
    assert trims == {"elevator": pytest.approx(0.02)}
    assert moved["elevator"].values == pytest.approx(record["elevator"].values)
    stepped = planted(
        [],
        None,
        1,
        flight=Flight(
            flight.time,
            (0.05 * (flight.time < 1.5) - 0.05 * (flight.time > 3.0))[None],
            max_step=0.02,
        ),
    )
    assert about_trim(stepped) == (stepped, {})
