"""Tolerance bands of simulator qualification: read, judged, refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.tolerances import (
    SOURCE,
    Tolerance,
    read_tests,
    tolerance_content,
    tolerance_figures,
    tolerance_table,
    verdicts_of,
)
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Record

DEGREE = np.pi / 180.0
TIME = np.arange(200) * 0.05
Q = 4.0 * DEGREE * np.sin(TIME)
THETA = 5.0 * DEGREE * np.sin(0.5 * TIME)
NZ = 1.0 + 0.3 * np.sin(TIME)
RECORD = Record(
    TIME,
    (),
    (Channel.of("theta", "rad", THETA), Channel.of("q", "rad/s", Q), Channel.of("nz", "g", NZ)),
    name="pulse",
)
NAMES = ("theta", "q", "nz")
ALL = "short-period,roll-response,rudder-response,small-inputs-roll,small-inputs-yaw,normal-takeoff"


def judged(theta: float, q: float, nz: float) -> bool:
    """The short period with constant errors in deg, deg/s and g."""
    rows = np.array([THETA + theta * DEGREE, Q + q * DEGREE, NZ + nz])
    (verdict,) = verdicts_of(read_tests("short-period"), RECORD, NAMES, rows)
    return verdict.passed


@given(st.floats(-3.0, 3.0), st.floats(-4.0, 4.0), st.floats(-0.2, 0.2))
def test_pitch_angle_or_pitch_rate_and_the_load_factor(theta: float, q: float, nz: float) -> None:
    wanted = (abs(theta) <= 1.5 or abs(q) <= 2.0) and abs(nz) <= 0.1
    near = min(abs(abs(theta) - 1.5), abs(abs(q) - 2.0), 10.0 * abs(abs(nz) - 0.1)) < 1e-6
    assert near or judged(theta, q, nz) is wanted


def test_a_share_widens_the_band_of_large_values() -> None:
    rate = Channel.of("p", "rad/s", np.array([0.0, 10.0, -40.0]) * DEGREE)
    of_value = Tolerance("p", "2 deg/s", 0.1).half_width(rate, "here")
    of_peak = Tolerance("p", "2 deg/s", 0.1, "peak").half_width(rate, "here")
    assert of_value / DEGREE == pytest.approx([2.0, 2.0, 4.0])
    assert of_peak / DEGREE == pytest.approx([4.0, 4.0, 4.0])


def test_one_sample_outside_fails_and_is_told_with_its_time() -> None:
    rows = np.array([THETA + 2.0 * DEGREE, Q, NZ])
    rows[1][60] += 3.0 * DEGREE
    (verdict,) = verdicts_of(read_tests("short-period"), RECORD, NAMES, rows)
    told = tolerance_content([verdict], RECORD)[0]
    assert not told["passed"] and told["source"] == SOURCE
    (rate,) = [each for each in told["channels"] if each["channel"] == "q"]
    assert rate["at"] == TIME[60] and rate["inside"] == pytest.approx(199 / 200)
    assert rate["worst_error"] == pytest.approx(3.0 * DEGREE)
    ((stem, draw),) = tolerance_figures([verdict], RECORD, NAMES, rows)
    figure = draw()
    assert stem == "tolerances_short-period" and len(figure.axes) == 3
    assert "fail" in figure.get_suptitle() or "fail" in figure.axes[0].get_title() or figure.texts


def test_errors_are_told_in_the_unit_of_the_tolerance() -> None:
    az = Channel.of("az", "m/s2", np.full(200, -9.8))
    record = Record(TIME, (), (RECORD["theta"], RECORD["q"], az), name="pulse")
    rows = np.array([THETA + 1.0 * DEGREE, Q, az.values + 0.08 * 9.80665])
    table = tolerance_table(
        verdicts_of(read_tests("short-period"), record, ("theta", "q", "az"), rows), record
    )
    told = [str(row[3]) for row in table.rows]
    assert told[1].startswith("+1 deg at") and told[3].startswith("+0.08 g at")


def test_every_test_of_the_data_file_is_read() -> None:
    for test in read_tests(ALL):
        assert test.entry and test.title and test.requirements


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[[tests]]\nname = "a"\nrequirements = [[{channel = "q", tolerance = "wide"}]]', "number"),
        ('[[tests]]\nname = "a"\nrequirements = [[{channel = "q", tolerance = "2 kg"}]]', "kg"),
        (
            '[[tests]]\nname = "a"\nrequirements = '
            '[[{channel = "q", tolerance = "2 deg/s", share = 2.0}]]',
            "no band",
        ),
        ("tests = 3", "tests"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(DeclarationError, match=line) as told:
        verdicts_of(read_tests(str(path)), RECORD, NAMES, np.array([THETA, Q, NZ]))
    assert "\n" not in str(told.value)


def test_unknown_tests_and_channels_are_refused() -> None:
    with pytest.raises(DeclarationError, match=r"short-period"):
        read_tests("short-perod")
    with pytest.raises(RecordError, match="needs p"):
        verdicts_of(read_tests("roll-response"), RECORD, NAMES, np.array([THETA, Q, NZ]))
