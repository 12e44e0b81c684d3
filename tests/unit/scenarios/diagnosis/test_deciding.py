"""What a deciding maneuver is asked: peaks of the records' inputs from where they begin."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.diagnosis.diagnose import _peaks, _text, by_hand
from sim.record import Channel, Record
from tests.bases import lateral_model

TIME = 0.1 * np.arange(50)


def record_of(**inputs: float) -> Record:
    """Inputs that begin at 0.3 and move by these to one side, less to the other."""
    wave = np.sin(TIME) * np.where(np.sin(TIME) > 0.0, 1.0, 0.4) / np.max(np.sin(TIME))
    channels = tuple(Channel.of(name, "rad", 0.3 + size * wave) for name, size in inputs.items())
    return Record(TIME, channels, (Channel.of("p", "rad/s", np.zeros(50)),))


def test_a_peak_is_the_largest_excursion_from_the_first_sample_over_all_records() -> None:
    found = _peaks(
        lateral_model(), [record_of(aileron=0.05), record_of(aileron=-0.08, rudder=0.02)]
    )
    assert found == {"aileron": pytest.approx(0.08), "rudder": pytest.approx(0.02)}
    assert _peaks(lateral_model(), [record_of(rudder=0.02)]) == {"rudder": pytest.approx(0.02)}


def test_numbers_are_asked_with_four_digits() -> None:
    assert _text("Cm_alpha", -0.123456) == "Cm_alpha=-0.1235"


def test_ramps_are_flown_by_hand_and_steps_between_samples_are_not() -> None:
    time = 0.02 * np.arange(200)

    def flown(rise: float) -> list[Record]:
        wave = np.clip((time - 1.0) / rise, 0.0, 1.0)
        channel = Channel.of("aileron", "rad", 0.05 * wave)
        return [Record(time, (channel,), (Channel.of("p", "rad/s", np.zeros(200)),))]

    model = lateral_model()
    assert by_hand(model, flown(0.2)) and not by_hand(model, flown(0.02))
    assert not by_hand(model, [*flown(0.2), *flown(0.02)])
