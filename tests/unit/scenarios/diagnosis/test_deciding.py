"""What a deciding maneuver is asked: peaks of the records' inputs from where they begin."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.diagnosis.deciding import _peaks, _text
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
