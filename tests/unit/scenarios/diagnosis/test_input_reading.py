"""When held inputs are read again as moving between samples, and how that is said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.diagnosis.opening import (
    Refit,
    left_open,
    moves_between_samples,
    no_worse,
    read_again,
    tells_times,
)
from scenarios.preparation.plan import BY_HAND
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.input_path.input_recorded_late import InputRecordedLate
from sim.record import Channel, Hold, Record
from tests.diagnoses import measured_record, tracing_of

CANDIDATES = (InputRecordedLate(), InputDelay("elevator"))


@pytest.mark.parametrize(
    ("name", "delay", "expected"),
    [
        ("input-recorded-late", 0.011, True),
        ("input-recorded-late", 0.04, False),
        ("input-delay", 0.011, False),
    ],
)
def test_only_an_input_ahead_by_less_than_a_sample_says_how_inputs_are_to_be_read(
    name: str, delay: float, expected: bool
) -> None:
    """Samples are 0.02 s apart."""
    found = replace(
        tracing_of(Verdict.TRACED).diagnosis,
        effects=(Claim(name, {"delay": Quantity(delay, 0.001, "s")}),),
    )
    record = measured_record()
    assert moves_between_samples(found, CANDIDATES, [record]) is expected
    assert not moves_between_samples(found, CANDIDATES, [replace(record, hold=Hold.LINEAR)])


def test_an_alternative_asks_for_the_second_reading_too() -> None:
    claim = Claim(
        "accelerometer-offset:nz",
        {"arm": Quantity(3.0, 0.1, "m")},
        ("elastic-mode", "input-recorded-late"),
    )
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(claim,))
    assert moves_between_samples(found, CANDIDATES, [measured_record()])
    assert not moves_between_samples(
        replace(found, effects=(replace(claim, alternatives=("elastic-mode",)),)),
        CANDIDATES,
        [measured_record()],
    )


def test_the_first_reading_stays_where_the_second_explains_less() -> None:
    traced, ambiguous, unexplained = (
        tracing_of(verdict).diagnosis
        for verdict in (Verdict.TRACED, Verdict.AMBIGUOUS, Verdict.UNEXPLAINED)
    )
    assert no_worse(traced, traced) and no_worse(traced, unexplained)
    assert not no_worse(ambiguous, traced) and not no_worse(unexplained, ambiguous)


def test_the_second_reading_was_chosen_by_no_hand() -> None:
    notes = (f"inputs linear between samples: {BY_HAND}", "a trim was taken off")
    first, second = read_again(notes)
    assert BY_HAND not in first and "--hold previous" in first and second == notes[1]


def through_samples(record: Record) -> Record:
    """The same with an elevator that takes five samples to get where it goes, as a surface does."""
    (elevator,) = record.inputs
    slow = np.convolve(elevator.values, np.ones(5) / 5.0)[: len(record)]
    return replace(record, inputs=(Channel.of("elevator", "rad", slow),))


def test_times_found_with_an_input_that_passes_through_samples_ask_for_a_second_reading() -> None:
    stepped = measured_record()
    passing = through_samples(stepped)
    late = Claim("sensor-delay:alpha", {"delay": Quantity(0.05, 0.001, "s")})
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(late,))
    assert tells_times(found, [passing])
    assert not tells_times(found, [stepped]) and not tells_times(
        found, [replace(passing, hold=Hold.LINEAR)]
    )
    assert not tells_times(
        replace(found, effects=(Claim("vane-offset", {"arm": Quantity(3.0, 0.1, "m")}),)), [passing]
    )


def test_where_both_readings_serve_what_differs_is_told() -> None:
    """Half an interval of 0.02 s is ten sigmas of a delay; nothing is told where one of the two
    readings fits clearly better, or where nothing moves.
    """
    late = Claim("sensor-delay:q", {"delay": Quantity(0.09, 0.001, "s")})
    first = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(late,), after={})
    moved = {"sensor-delay:q.delay": 0.10}
    (told,) = left_open(Refit(0.0, moved), first)
    assert "sensor-delay:q.delay 0.1 for 0.09" in told and "--hold linear" in told
    assert left_open(Refit(0.0, {"sensor-delay:q.delay": 0.0905}), first) == ()
    assert left_open(Refit(-11.0, moved), first) == () == left_open(Refit(11.0, moved), first)
    assert left_open(Refit(-math.inf, {}), first) == ()
