"""Grades of answers about independent flights: a table, sizes, held-out error, the command's
files.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exam.independent import command
from exam.independent.causes import (
    Scales,
    accelerometer_ahead,
    boom,
    lagged,
    late_sensor,
    shifted,
    with_play,
)
from exam.independent.folders import Recorder, recorded
from exam.independent.grading import (
    Answer,
    Grade,
    grade,
    held_out,
    predictable,
    said_with,
    sizes,
)

LATE = {
    "right": ["sensor-delay:alpha", "sensor-lag:alpha"],
    "near": ["vane-offset"],
    "words": ["alpha"],
}
SCALE = {"right": ["sensor-scale:q"], "near": [], "words": ["q"]}
FOREIGN = {"right": [], "near": ["flow-separation"], "words": ["alpha"]}
CLEAN: list[dict[str, Any]] = []


def truth(*causes: dict[str, Any], harmless: Sequence[str] = ("phugoid",)) -> dict[str, Any]:
    return {
        "accepted": list(causes),
        "harmless": list(harmless),
        "values": {"sensor-delay:alpha": {"delay": 0.05}},
    }


def answer(verdict: str, *claims: str | dict[str, Any], warnings: Sequence[str] = ()) -> Answer:
    effects = [{"name": claim} if isinstance(claim, str) else claim for claim in claims]
    return Answer(0, {"verdict": verdict, "effects": effects, "warnings": list(warnings)})


VANE = {"name": "vane-offset", "alternatives": ["sensor-lag:alpha"]}
HINT = {"name": "sensor-drift:nz", "claimed": False}


@pytest.mark.parametrize(
    ("hidden", "given", "expected"),
    [
        ((), answer("consistent"), Grade.RIGHT),
        ((), answer("traced", "phugoid"), Grade.RIGHT),
        ((), answer("unexplained", HINT), Grade.ALARM),
        ((), answer("partial", "sensor-drift:nz"), Grade.WRONG),
        ((), Answer(2, {}, "the file has no row"), Grade.REFUSED),
        ((), Answer(1, {}, "Traceback"), Grade.FAILED),
        ((LATE,), answer("traced", "sensor-lag:alpha"), Grade.RIGHT),
        ((LATE,), answer("traced", "sensor-lag:alpha", "phugoid"), Grade.RIGHT),
        ((LATE,), answer("traced", VANE), Grade.RIGHT),
        ((LATE,), answer("traced", "vane-offset"), Grade.WRONG),
        ((LATE,), answer("traced", "sensor-lag:alpha", "sensor-drift:nz"), Grade.WRONG),
        ((LATE,), answer("unexplained"), Grade.NOTICED),
        ((LATE,), answer("consistent"), Grade.MISSED),
        ((LATE,), answer("consistent", warnings=["the column alpha is odd"]), Grade.NOTICED),
        ((LATE, SCALE), answer("traced", "sensor-lag:alpha", "sensor-scale:q"), Grade.RIGHT),
        ((LATE, SCALE), answer("traced", "sensor-lag:alpha"), Grade.NOTICED),
        ((FOREIGN,), answer("unexplained"), Grade.RIGHT),
        ((FOREIGN,), answer("traced", "flow-separation"), Grade.RIGHT),
        ((FOREIGN,), answer("traced", "sensor-scale:q"), Grade.WRONG),
        ((FOREIGN,), answer("consistent"), Grade.MISSED),
    ],
)
def test_grades(hidden: tuple[dict[str, Any], ...], given: Answer, expected: Grade) -> None:
    assert grade(truth(*hidden), given)[0] is expected


def test_sizes_count_claims_of_planted_causes_only() -> None:
    delay = {"name": "sensor-delay:alpha", "parameters": {"delay": {"value": 0.06, "std": 0.002}}}
    other = {"name": "sensor-scale:q", "parameters": {"scale": {"value": 1.1, "std": 0.01}}}
    assert sizes(truth(LATE), answer("traced", delay, other)) == pytest.approx([5.0])
    assert predictable(truth(LATE)) and not predictable(truth(LATE, FOREIGN))
    assert not predictable(truth({"right": ["gust-turbulence"], "near": [], "words": []}))


def test_held_out_error_is_of_the_worst_channel(tmp_path: Path) -> None:
    (tmp_path / "validate.csv").write_text(
        "time [s],alpha [rad],q [rad/s]\n0,0.1,0\n1,0.2,0\n", encoding="utf-8"
    )
    predicted = "time,before_alpha,after_alpha,before_q,after_q\n0,0.1,0.11,1,0\n1,0.2,0.19,1,0.1\n"
    (tmp_path / "validate_prediction.csv").write_text(predicted, encoding="utf-8")
    told = {"sigma": {"alpha": 0.01, "q": 0.1}}
    assert held_out(tmp_path, tmp_path, told) == pytest.approx(1.0)
    assert held_out(tmp_path, tmp_path, told, "before") == pytest.approx(10.0)
    assert np.isnan(held_out(tmp_path, tmp_path / "nowhere", told))


def test_causes_against_their_definitions() -> None:
    step, rng = 0.0025, np.random.default_rng(0)
    time = step * np.arange(4000)
    wave = np.sin(3.0 * time)
    np.testing.assert_allclose(
        shifted(wave, step, 0.1)[100:], np.sin(3.0 * (time[100:] - 0.1)), atol=1e-5
    )
    settled = lagged(wave, step, 0.2)[2000:]
    np.testing.assert_allclose(np.ptp(settled) / 2.0, 1.0 / np.hypot(1.0, 0.6), rtol=1e-3)
    np.testing.assert_allclose(np.ptp(with_play(wave, 0.1)[1500:]) / 2.0, 0.9, rtol=1e-3)
    still = np.zeros_like(time)
    turning = {"alpha": still, "q": still + 0.2, "airspeed": still + 40.0, "nz": still + 1.0}
    vane = boom("alpha", Scales(2.0, 0.5), rng)
    arm = vane.planted.values["vane-offset"]["arm"]
    np.testing.assert_allclose(vane.plant(turning, step)["alpha"], -np.arctan(0.2 * arm / 40.0))
    ahead = accelerometer_ahead("nz", Scales(2.0, 0.5), rng)
    arm = ahead.planted.values["accelerometer-offset:nz"]["arm"]
    ramp = ahead.plant({**turning, "q": 0.3 * time}, step)["nz"]
    np.testing.assert_allclose(ramp, 1.0 + 0.3 * arm / 9.80665)
    late = late_sensor("q", Scales(2.0, 0.5), rng)
    assert late.planted.right == ("sensor-delay:q", "sensor-lag:q")


def test_the_recorder_filters_all_channels_alike_and_knows_its_noise() -> None:
    step = 0.0025
    wave = 0.1 * np.sin(5.0 * step * np.arange(20001))
    how = Recorder(50.0, 8.0)
    time, columns, sigmas = recorded(
        {"elevator": wave, "alpha": wave}, step, ("elevator",), how, np.random.default_rng(3)
    )
    assert time[1] == pytest.approx(0.02) and len(time) == len(columns["alpha"]) == 2501
    noise = columns["alpha"] - columns["elevator"]
    assert sigmas["alpha"] == pytest.approx(float(np.std(noise)), rel=1e-9)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] > 0.1, (
        "noise that passed the filter is coloured"
    )
    with pytest.raises(ValueError, match="does not divide"):
        recorded({"alpha": wave}, step, (), Recorder(33.0, None), np.random.default_rng(3))


FAKE = """
import json, pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
(out / "diagnosis.json").write_text(json.dumps({"verdict": "consistent", "effects": [], "warnings": []}))
"""  # noqa: E501


def test_the_command_scores_folders_and_keeps_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "flights" / "002"
    folder.mkdir(parents=True)
    content = {
        **truth(LATE),
        "model": "rigid",
        "aircraft": "none",
        "hidden": ["late alpha"],
        "sigma": {"alpha": 1.0},
    }
    (folder / "truth.json").write_text(json.dumps(content), encoding="utf-8")
    (folder / "train-1.csv").write_text("", encoding="utf-8")
    fake = tmp_path / "fake.py"
    fake.write_text(FAKE, encoding="utf-8")
    line = [
        "--score",
        str(tmp_path / "flights"),
        "--out",
        str(tmp_path / "marks"),
        "--command",
        f"{sys.executable} {fake}",
    ]
    assert command.main(line) == 0
    told = capsys.readouterr().out
    assert "missed" in told and "Right: 0 of 1" in told
    rows = (tmp_path / "marks" / "flights.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("flight,model") and rows[1].startswith(
        "002,rigid,none,late alpha,missed"
    )
    fake.write_text("raise SystemExit(9)", encoding="utf-8")
    assert command.main(line) == 0, "the answer that is there is graded again"
    assert "missed" in capsys.readouterr().out


@pytest.mark.parametrize(
    "line",
    [
        [],
        ["--out", "x"],
        ["--score", "nowhere", "--out", "x"],
        ["--score", ".", "--out", "x", "--only", "a"],
    ],
)
def test_a_request_that_makes_no_sense_is_one_line(
    line: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(line) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_names_are_counted_with_the_probability_that_they_are_said_with() -> None:
    late = {"name": "sensor-lag:alpha", "probability": {"sensor-lag:alpha": 0.97}}
    scale = {"name": "sensor-scale:nz", "probability": {"sensor-scale:nz": 0.6}}
    slow = {"name": "phugoid", "probability": {"phugoid": 1.0}}
    plain = {"name": "sensor-drift:q"}
    said = said_with(truth(LATE), answer("partial", late, scale, slow, plain, HINT))
    assert said == [(0.97, True), (0.6, False), (1.0, True)]
