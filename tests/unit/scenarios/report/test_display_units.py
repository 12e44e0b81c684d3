"""One display unit a quantity: figures take theirs from the table of the terminal, and a frequency
is never shown in deg/s.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from scenarios.cli.libraries import show_effects
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.plots.display import display_unit
from scenarios.report.quantities import (
    DEGREES,
    in_hertz,
    number_text,
    quantity_text,
    shown_in,
    span_text,
    unit_cell,
    value_parts,
)
from scenarios.report.summary import table_lines
from scenarios.responses.loops import UNITS
from scenarios.studies.declaration import Row
from scenarios.studies.text import with_display
from sim.effects.library import library


def test_figures_and_tables_share_one_unit() -> None:
    parameters = {(item.unit, item.name) for effect in library() for item in effect.parameters}
    for unit, name in {
        *parameters,
        *((unit, name) for name, unit in CHANNEL_UNITS.items()),
        *((unit, "") for unit in DEGREES),
    }:
        factor, shown = shown_in(unit, name)
        drawn = display_unit(unit, name)
        assert drawn.factor == factor
        assert drawn.text.replace("²", "2").replace("³", "3") == (
            shown if unit_cell(shown) else "–"
        ), (unit, name)
        assert not ("frequency" in name and shown.startswith("deg"))


def test_numbers_without_a_sigma() -> None:
    assert (
        quantity_text(0.00872665, "rad", "half_width") == "0.5 deg"
        and quantity_text(12.0, "rad/s", "omega1") == "12 rad/s (1.91 Hz)"
    )
    assert (
        quantity_text(4.0, "m") == "4 m"
        and quantity_text(0.3, "1") == "0.3"
        and quantity_text(math.pi, "rad/s", "rate") == "180 deg/s"
    )
    assert in_hertz(1.0, "rate", "rad/s") == "" and shown_in("rad/s", "L_0") == (1.0, "rad/s"), (
        "a load, read beside derivatives"
    )


def test_an_effect_is_shown_in_degrees_and_fits(capsys: pytest.CaptureFixture[str]) -> None:
    show_effects("input-deadband")
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if line.strip().startswith("half_width"))
    assert row.split()[1:3] == ["deg", "0.573"] and "from 0 up" in row and "0 to 5.73" in row
    assert max(map(len, lines)) <= 100 and table_lines([]) == []


def test_rows_of_a_study_are_shown_so_and_a_frequency_in_hertz_as_well() -> None:
    rows = [
        Row("omega1", "rad/s", 12.0, 0.1, 12.5),
        Row("bias_q", "rad/s", 0.01, 0.001),
        Row("Cm_q", "1/rad", -3.0, 0.1),
    ]
    study: Any = SimpleNamespace(scenario=SimpleNamespace(display={}))
    shown = with_display(study, rows)
    assert [(row.name, row.unit) for row in shown] == [
        ("omega1", "rad/s"),
        ("omega1", "Hz"),
        ("bias_q", "deg/s"),
        ("Cm_q", "1/rad"),
    ]
    assert shown[1].estimate == pytest.approx(12.0 / (2.0 * math.pi)) and shown[
        1
    ].sigmas == pytest.approx(rows[0].sigmas)
    assert shown[2].std == pytest.approx(math.degrees(0.001))


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("m/s/s", "m/s2"), ("rad/s/s", "deg/s2"), ("g/s", "g/s"), ("1/s/s", "1/s2")],
)
def test_a_drift_of_a_rate_is_in_seconds_squared(unit: str, shown: str) -> None:
    assert shown_in(unit).unit == shown


@pytest.mark.parametrize(
    ("value", "sigma", "shown"),
    [
        (0.060047, 2.7e-5, ("0.060047", "0.000027")),
        (-26.86, 1.708, ("-26.9", "1.7")),
        (288017.0, 43210.0, ("288017", "43210")),
        (4.7e-5, 3.3e-5, ("0.000047", "0.000033")),
        (1.5e-12, 2.0e-13, ("1.50e-12", "2.0e-13")),
        (-0.016, 11.0, ("0", "11")),
    ],
)
def test_two_digits_of_a_sigma_and_the_value_to_the_same_decimal(
    value: float, sigma: float, shown: tuple[str, str]
) -> None:
    assert (number_text(value, sigma), number_text(sigma, sigma)) == shown
    if sigma > 1e-8:
        decimals = {len(text.partition(".")[2]) for text in value_parts(value, sigma)}
        assert len(decimals) == 1


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [
        (-4.4, 3.82, "-4.40 to 3.82"),
        (0.00272, 1.88, "0.00 to 1.88"),
        (-0.0001, 25.0, "0.0 to 25.0"),
        (0.0, 0.0, "0 to 0"),
        (-1234.6, 3.0, "-1235 to 3"),
    ],
)
def test_both_ends_of_a_span_have_the_same_decimals(low: float, high: float, told: str) -> None:
    assert span_text(low, high) == told


def test_a_gain_is_no_angular_acceleration_and_a_distance_has_no_unit() -> None:
    assert shown_in("rad/s2", "gain").unit == "rad/s2"
    assert UNITS["distance"] == "1"
