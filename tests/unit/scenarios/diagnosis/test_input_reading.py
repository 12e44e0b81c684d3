"""When held inputs are read again as moving between samples, and how that is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.diagnosis.input_reading import moves_between_samples, no_worse, read_again
from scenarios.preparation.plan import BY_HAND
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.input_path.input_recorded_late import InputRecordedLate
from sim.record import Hold
from tests.diagnoses import measured_record, tracing_of

CANDIDATES = (InputRecordedLate(), InputDelay("elevator"))


@pytest.mark.parametrize(
    ("name", "delay", "expected"),
    [("input-recorded-late", 0.011, True), ("input-recorded-late", 0.04, False), ("input-delay", 0.011, False)],
)
def test_only_an_input_ahead_by_less_than_a_sample_says_how_inputs_are_to_be_read(name: str, delay: float, expected: bool) -> None:
    """Samples are 0.02 s apart."""
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(Claim(name, {"delay": Quantity(delay, 0.001, "s")}),))
    record = measured_record()
    assert moves_between_samples(found, CANDIDATES, [record]) is expected
    assert not moves_between_samples(found, CANDIDATES, [replace(record, hold=Hold.LINEAR)])


def test_an_alternative_asks_for_the_second_reading_too() -> None:
    claim = Claim("accelerometer-offset:nz", {"arm": Quantity(3.0, 0.1, "m")}, ("elastic-mode", "input-recorded-late"))
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(claim,))
    assert moves_between_samples(found, CANDIDATES, [measured_record()])
    assert not moves_between_samples(replace(found, effects=(replace(claim, alternatives=("elastic-mode",)),)), CANDIDATES, [measured_record()])


def test_the_first_reading_stays_where_the_second_explains_less() -> None:
    traced, ambiguous, unexplained = (tracing_of(verdict).diagnosis for verdict in (Verdict.TRACED, Verdict.AMBIGUOUS, Verdict.UNEXPLAINED))
    assert no_worse(traced, traced) and no_worse(traced, unexplained)
    assert not no_worse(ambiguous, traced) and not no_worse(unexplained, ambiguous)


def test_the_second_reading_was_chosen_by_no_hand() -> None:
    notes = (f"inputs linear between samples: {BY_HAND}", "a trim was taken off")
    first, second = read_again(notes)
    assert BY_HAND not in first and "--hold previous" in first and second == notes[1]
