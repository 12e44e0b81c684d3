"""Sizes of weak effects, counts and intervals of the tracing campaigns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from exam.aircraft import NOISE, drawn_aircraft
from exam.detection import (
    SETTINGS,
    Alarm,
    Detection,
    Finding,
    alarm_rows,
    detection_rows,
    flown,
    found,
    size_of,
    with_effect,
)
from exam.detection import _first as first_maneuver
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.report.terminal import cell_text
from tests.diagnoses import tracing_of


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["input-deadband", "vane-offset"])
def test_size_brings_the_expected_gain(effect: str) -> None:
    _, model = drawn_aircraft(np.random.default_rng(4))
    size = size_of(model, effect, 25.0, SETTINGS[0])
    changed = flown(with_effect(model, effect, size), first_maneuver(), SETTINGS[0])
    names, states = model.parameters.free_names, model.initial.names

    def misfit(x: np.ndarray) -> np.ndarray:
        values = {
            name: model.parameters[name].value * (1.0 + part)
            for name, part in zip(names, x, strict=False)
        }
        initial = model.initial.with_values(
            {state: 0.01 * part for state, part in zip(states, x[len(names) :], strict=True)}
        )
        rows = flown(model.with_values(values).with_initial(initial), first_maneuver(), SETTINGS[0])
        rest = [
            (changed[name].values - rows[name].values) / NOISE[name]
            for name in SETTINGS[0].channels
        ]
        return np.concatenate([row - row.mean() for row in rest])

    left = least_squares(misfit, np.zeros(len(names) + len(states)), max_nfev=6).fun
    assert 0.5 * float(left @ left) == pytest.approx(25.0, rel=0.15)


def test_rows_count_what_they_say() -> None:
    alarms = [
        Alarm(0, "light", "consistent", (), 1.0),
        Alarm(1, "light", "traced", ("vane-offset",), 3.0),
        Alarm(2, "light", "unexplained", (), 2.0),
    ]
    row = [cell_text(cell) for cell in alarm_rows({"all": alarms})[0]]
    assert row[:4] == ["all", "3", "1", "2"] and row[-1] == "2.0"
    group = [
        Detection(i, "input-delay", 25.0, 0.01, finding, (), 1.0)
        for i, finding in enumerate(Finding)
    ]
    row = [cell_text(cell) for cell in detection_rows(group, lambda d: d.effect)[0]]
    assert row[:7] == ["input-delay", "5", "4", "1", "1", "1", "1"]


def test_a_lag_and_a_delay_of_one_sensor_are_one() -> None:
    from dataclasses import replace

    made = tracing_of(Verdict.TRACED).diagnosis
    named = lambda *claims: replace(made, effects=tuple(claims))  # noqa: E731
    assert found("sensor-lag:q", named(Claim("sensor-delay:q", {}))) is Finding.RIGHT
    assert found("sensor-lag:q", named(Claim("sensor-delay:alpha", {}))) is Finding.WRONG
    assert (
        found("sensor-lag:q", named(Claim("input-delay", {}, ("sensor-lag:q",))))
        is Finding.AMBIGUOUS
    )
    assert found("input-delay", tracing_of(Verdict.CONSISTENT).diagnosis) is Finding.MISSED
    assert found("input-delay", tracing_of(Verdict.UNEXPLAINED).diagnosis) is Finding.UNEXPLAINED
