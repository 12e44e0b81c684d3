"""Sentences about a study: the periodogram they stand on, and when they are said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.studies.catalogue import load_scenario
from scenarios.studies.study import (
    elastic_frequencies,
    periodogram,
    prior_note,
    residual_note,
    run_scenario,
)
from sim.vehicles.factory import flexible_model, rigid_model
from sim.vehicles.library import read_parameter_set


@given(st.floats(5.0, 200.0), st.floats(0.0, 6.0))
def test_a_tone_is_found_at_its_frequency(omega: float, phase: float) -> None:
    t = np.arange(801) * 0.01
    frequencies, power = periodogram(np.sin(omega * t + phase) + 0.3, 0.01)
    assert frequencies[np.argmax(power)] == pytest.approx(omega, abs=0.2)


def test_elastic_frequencies_leave_the_short_period_out() -> None:
    data = read_parameter_set("bomber_ac1")
    assert elastic_frequencies(flexible_model(data)) == pytest.approx(
        [12.4, 16.8, 21.2, 22.1], abs=0.1
    )
    assert elastic_frequencies(rigid_model(data)) == []


def test_notes_name_what_only_the_prior_determines() -> None:
    scenario = load_scenario(
        "rigid",
        [
            "flight.duration=3",
            "flight.rate=20",
            "flight.step=0.01",
            "estimate.start.CL_de.std=0.001",
        ],
    )
    result = run_scenario(scenario).main.result
    assert "CL_de" in prior_note(result)
    assert "Cm_de" not in prior_note(result)
    assert residual_note(result, rigid_model(read_parameter_set("bomber_rigid"))) == ""
