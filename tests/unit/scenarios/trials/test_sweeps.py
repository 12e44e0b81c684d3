"""Sweeps of loops that are known: the flight, the truth, the study, what is refused."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import flightid as fid
from scenarios.cli import main
from scenarios.report.quantities import as_text
from scenarios.studies.catalogue import load_document, scenario_names
from scenarios.trials.sweeps import (
    SweepScenario,
    fly_sweep,
    print_sweep,
    run_sweep,
    sweep_comparison,
    sweep_scenario_of,
    true_loop,
    true_margins,
    true_parameters,
)
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import margins
from sim.errors import DeclarationError


def scenario(name: str = "uav-sweep", *changes: str) -> SweepScenario:
    return sweep_scenario_of(*load_document(name, changes))


SHORT = ("sweep.duration=30 s", "sweep.flights=1", 'band=["0.4 Hz", "12 Hz"]')


def typed(*words: str | Path) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


def test_the_flight_is_the_roll_axis_integrated_finely() -> None:
    """Roll rate from the recorded command in steps of a hundredth of a frame, the command late by
    the delay.
    """
    quiet = replace(scenario("uav-sweep", *SHORT), gyro=0.0, rough_air=0.0)
    loop = quiet.loop
    assert loop is not None
    record = fly_sweep(quiet, np.random.default_rng(1))
    command, p = record["command"].values[:400], record["p"].values[:400]
    np.testing.assert_allclose(
        record["command"].values, record["sweep"].values - record["returned"].values, atol=1e-12
    )
    fine, step = 100, 1.0 / loop.rate / 100
    late = round(loop.delay / step)
    held = np.concatenate([np.zeros(late), np.repeat(command, fine)])
    rate, found = 0.0, [0.0]
    for n in range(399 * fine):
        gained = loop.gain * held[n] / loop.inv_T_roll
        rate = gained + (rate - gained) * math.exp(-loop.inv_T_roll * step)
        if (n + 1) % fine == 0:
            found.append(rate)
    np.testing.assert_allclose(p, found, atol=1e-9)
    angle = np.cumsum(p) / loop.rate
    np.testing.assert_allclose(
        record["returned"].values[:400], loop.proportional * p + loop.integral * angle, atol=1e-9
    )


@pytest.mark.long
def test_true_margins_are_those_of_the_true_response() -> None:
    one = scenario()
    found = true_margins(one)

    def gain(omega: float) -> float:
        return float(np.abs(true_loop(one, np.array([omega]))[0]))

    def phase(omega: float) -> float:
        return float(np.angle(-true_loop(one, np.array([omega]))[0]))

    crossover = brentq(lambda w: gain(w) - 1.0, 5.0, 40.0)
    assert found["phase_margin"] == pytest.approx(math.degrees(phase(crossover)), abs=0.01)
    assert found["delay_margin"] == pytest.approx(phase(crossover) / crossover, rel=1e-3)
    turn = brentq(phase, 25.0, 80.0)
    assert found["gain_increase"] == pytest.approx(-20.0 * math.log10(gain(turn)), abs=0.01)
    assert true_parameters(one) == {"gain": 95.0, "inv_T_roll": 9.0, "delay": 0.032}


@pytest.mark.long
def test_the_x29_like_loop_has_its_own_margins() -> None:
    found, exact = true_margins(scenario("x29-margins")), margins(load_x29("F"))
    assert found["gain_increase"] == pytest.approx(exact.gain_increase, abs=0.01)
    assert found["gain_decrease"] == pytest.approx(exact.gain_decrease, abs=0.01)
    assert found["phase_margin"] == pytest.approx(exact.phase, abs=0.01)
    assert true_parameters(scenario("x29-margins")) == {}


@pytest.mark.long
def test_a_study_finds_the_truth_and_the_same_seed_the_same_numbers() -> None:
    one = scenario()
    study = run_sweep(one, 3)
    errors = {row.name: row.sigmas for row in study.rows}
    assert {"gain", "inv_T_roll", "delay", "gain_increase", "phase_margin", "delay_margin"} <= set(
        errors
    )
    assert all(error is not None and abs(error) < 4.0 for error in errors.values()), errors
    assert len(study.records) == 3 and not np.array_equal(
        study.records[0]["p"].values, study.records[1]["p"].values
    )
    again = run_sweep(one, 3)
    assert [row.estimate for row in again.rows] == [row.estimate for row in study.rows]
    text = as_text(lambda out: print_sweep(study, out))
    assert "Against the truth" in text and "The worst maneuver" in text
    assert "deg/s2" not in text and re.search(r"gain +rad/s2 +95 ", text)
    assert re.search(r"least distance from -1 +0\.", text) is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uav-sweep", "x29-margins"])
def test_intervals_of_the_scenarios_hold(name: str) -> None:
    one, inside = scenario(name), []
    for seed in range(30):
        study = run_sweep(one, seed)
        loop = study.loop.loop
        assert loop is not None
        known = loop.margins.named
        for row in study.rows:
            if row.true is not None:
                ends = (row.estimate - 1.96 * row.std, row.estimate + 1.96 * row.std)
                if row.name in known:
                    ends = (known[row.name].low, known[row.name].high)
                inside.append(ends[0] <= row.true <= ends[1])
    assert 0.9 <= np.mean(inside) <= 0.995


@pytest.mark.long
def test_from_the_command_line_and_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = [word for change in SHORT for word in ("--set", change)]
    assert typed("run", "uav-sweep", *changes, "--out", tmp_path / "study") == 0
    assert "phase_margin" in capsys.readouterr().out
    written = json.loads((tmp_path / "study" / "comparison.json").read_text())
    assert (
        written["schema"] == "flightid/comparison/1"
        and written["parameters"]["gain"]["true"] == 95.0
    )
    assert {path.name for path in (tmp_path / "study").iterdir()} >= {
        "comparison.json",
        "truth.json",
        "record.csv",
        "responses.csv",
        "response.png",
        "loop.png",
        "report.html",
    }
    assert "Stability margins" in (tmp_path / "study" / "report.html").read_text()
    study = fid.run("uav-sweep", set=list(SHORT))
    assert (
        study.kind == "sweep" and study["gain"].value == written["parameters"]["gain"]["estimate"]
    )
    assert (
        study.true["inv_T_roll"] == 9.0
        and "sigmas" in study.to_dataframe()
        and "Against" in study.summary()
    )
    assert len(study.records) == 1
    with pytest.raises(fid.InputError, match="no matrices"):
        study.to_state_space()
    assert typed("simulate", "uav-sweep", *changes, "--out", tmp_path / "flight.csv") == 0
    words = (
        "--input",
        "command",
        "--output",
        "returned",
        "--reference",
        "sweep",
        "--margins",
        "minus",
        "--band",
        "0.4",
        "12",
    )
    capsys.readouterr()
    assert typed("response", tmp_path / "flight.csv", *words) == 0
    assert "gain increase" in capsys.readouterr().out


@pytest.mark.long
def test_content_is_strict() -> None:
    text = json.dumps(
        sweep_comparison(run_sweep(scenario("x29-margins", "sweep.flights=1"), 1)),
        allow_nan=False,
        default=str,
    )
    assert "null" not in text


@pytest.mark.long
def test_every_sweep_of_the_catalogue_is_read_and_has_its_truth() -> None:
    names = scenario_names("sweep")
    assert set(names) == {"uav-sweep", "x29-margins"}
    for name in names:
        assert "phase_margin" in true_margins(scenario(name))


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["airframe=F"], "one of loop and airframe is due"),
        (["sweep.low=20 Hz"], "a sweep from 20 to 15 Hz"),
        (["sweep.high=45 Hz"], "below 40 Hz"),
        (["sweep.duration=2 s"], "five periods"),
        (["loop.gain=-3"], "not above 0"),
        (["loop.delay=3 m"], "delay"),
        (["sweep.colour=red"], "colour"),
        (["loop.proportional=4"], "the loop is unstable"),
        (["form=pich"], "there is no form"),
    ],
)
def test_faults_are_one_line(
    capsys: pytest.CaptureFixture[str], changes: list[str], said: str
) -> None:
    assert (
        typed("run", "uav-sweep", *(word for change in changes for word in ("--set", change))) == 2
    )
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err


def test_an_airframe_has_no_form() -> None:
    with pytest.raises(DeclarationError, match="leave form out"):
        scenario("x29-margins", "form=roll")


def test_a_band_that_is_too_low_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert typed("run", "uav-sweep", "--set", 'band=["0.001 Hz", "5 Hz"]') == 2
    assert "is below" in capsys.readouterr().err
