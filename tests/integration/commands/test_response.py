"""`flightid response`: any record and any column, from a terminal and from Python."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import signal

import flightid as fid
from scenarios.cli import main
from scenarios.responses.loops import margin_lines
from scenarios.responses.qualities import chart_levels
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import loop_test, margins
from tests.recorders.logs import write_dataflash

RATE = 400.0
LAG, DELAY, GAIN = 0.08, 0.02, 0.9  # s, s, of the roll rate behind its target


def typed(*words: str | Path) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


def chirp_flight(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, target and measured roll rate (deg/s) of a frequency sweep of 60 s at 400 Hz."""
    time = np.arange(int(60.0 * RATE)) / RATE
    target = 20.0 * signal.chirp(time, 0.1, 60.0, 8.0, method="logarithmic")
    decay = math.exp(-1.0 / (RATE * LAG))
    late = np.concatenate([np.zeros(round(DELAY * RATE)), target])[: time.size]
    rate = GAIN * signal.lfilter([1.0 - decay], [1.0, -decay], late)
    return time, target, rate + np.random.default_rng(seed).normal(0.0, 1.0, time.size)


def write_log(folder: Path) -> Path:
    """A DataFlash log with the messages of ArduPilot's system identification mode: the chirp of
    the roll rate (SIDD, 400 Hz), what was asked (SIDS), and the rate controller (RATE, 100 Hz)."""
    time, target, rate = chirp_flight()
    stamps = np.round(1e6 * (5.0 + time)).astype(int)
    other = np.random.default_rng(7).normal(0.0, 0.3, (5, time.size))
    frequency = 0.1 * 80.0 ** (time / 60.0)
    messages = {
        "SIDS": {"TimeUS": stamps[:1], "Ax": np.array([7.0]), "Mag": np.array([20.0])},
        "SIDD": {
            **{"TimeUS": stamps, "Time": time, "Targ": target, "F": frequency},
            **{"Gx": rate, "Gy": other[0], "Gz": other[1]},
            **{"Ax": other[2], "Ay": other[3], "Az": other[4] - 9.81},
        },
        "RATE": {"TimeUS": stamps[::4], "RDes": target[::4], "R": rate[::4]},
    }
    units = {"SIDS": "s--", "SIDD": "ss--kkkooo", "RATE": "skk"}
    return write_dataflash(folder / "00000012.BIN", messages, units)


def exact(frequency: np.ndarray) -> np.ndarray:
    """Of the lag as it is simulated, sample by sample."""
    later = np.exp(-2j * math.pi * frequency / RATE)
    decay = math.exp(-1.0 / (RATE * LAG))
    return GAIN * later ** round(DELAY * RATE) * (1.0 - decay) / (1.0 - decay * later)


def write_csv(folder: Path, name: str = "flight.csv", **columns: np.ndarray) -> Path:
    path = folder / name
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(repr(float(cell)) for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.long
def test_a_log_of_a_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = write_log(tmp_path), tmp_path / "bode"
    words = ["response", str(log), "--input", "SIDD.Targ", "--output", "SIDD.Gx", "--out", str(out)]
    assert typed(*words) == 0
    printed = capsys.readouterr().out
    assert (
        "SIDD.Gx/SIDD.Targ" in printed
        and "usable from" in printed
        and "decimated from 400" in printed
    )
    found = json.loads((out / "responses.json").read_text())
    assert found["schema"] == "flightid/responses/1" and found["method"] == "direct"
    one = found["responses"][0]
    usable = np.array(one["usable"])
    low, high = one["usable_band_Hz"]
    assert low < 0.3 and high > 4.0
    frequency = np.array(one["frequency_Hz"])
    response = np.array(one["real"]) + 1j * np.array(one["imaginary"])
    error = np.abs(response / exact(frequency) - 1.0)[usable]
    assert np.median(error) < 0.03
    inside = np.abs(response - exact(frequency)) <= 2.5 * np.array(one["std"])
    assert np.mean(inside[usable]) > 0.85
    with (out / "responses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == frequency.size and rows[0]["output"] == "SIDD.Gx"
    assert float(rows[3]["real"]) == one["real"][3]
    assert sorted(found["files"]) == [
        "report.html",
        "report.json",
        "response.png",
        "responses.csv",
        "responses.json",
    ]
    page = (out / "report.html").read_text()
    assert "coherence" in page and "<svg" in page


@pytest.mark.long
def test_python_gives_the_command(tmp_path: Path) -> None:
    time, target, rate = chirp_flight(2)
    path = write_csv(tmp_path, time=time[::8], wanted=target[::8], p=np.radians(rate[::8]))
    out = tmp_path / "bode"
    words = ["response", str(path), "--input", "wanted", "--output", "p", "--band", "0.2", "6"]
    assert typed(*words, "--out", out, "--quiet", "--no-figures") == 0
    written = json.loads((out / "responses.json").read_text())
    found = fid.frequency_response(path, "wanted", "p", band=(0.2, 6.0))
    assert found.to_dict()["responses"] == written["responses"]
    assert "usable" in found.summary() and "FrequencyResponse" in repr(found)
    frame = found.to_dataframe()
    np.testing.assert_array_equal(frame["real"], found.response[0, 0].real)
    control = found.to_control()
    np.testing.assert_allclose(np.ravel(control.frdata), found.response[0, 0])
    np.testing.assert_allclose(control.omega, 2.0 * math.pi * found.frequency)
    assert control.input_labels == ["wanted"] and control.output_labels == ["p"]
    assert found.plot.response().axes and "<table" in found._repr_html_()
    assert found.usable.any() and found.coherence.shape == (1, found.frequency.size)
    assert found.std.shape == found.response.shape and found.warnings == ()
    assert found.report(tmp_path / "page.html").is_file()
    assert found.save(tmp_path / "kept", figures=False).joinpath("responses.csv").is_file()
    with pytest.raises(fid.InputError, match="there is no output 'q'"):
        found.to_dataframe("q")


def test_degrees_of_a_channel_become_radians_and_other_columns_stay(tmp_path: Path) -> None:
    time, target, rate = chirp_flight(3)
    columns = {
        "time": time[::8],
        "wanted": target[::8],
        "p [deg/s]": rate[::8],
        "gyro [deg/s]": rate[::8],
    }
    path = tmp_path / "flight.csv"
    body = np.column_stack(list(columns.values()))
    np.savetxt(path, body, delimiter=",", header=",".join(columns), comments="")
    found = fid.frequency_response(path, "wanted", ["p", "gyro"], band=(0.2, 6.0))
    np.testing.assert_allclose(np.rad2deg(1.0) * found.response[0], found.response[1], rtol=1e-12)
    units = [each["unit"] for each in found.to_dict()["responses"]]
    assert units == ["rad/s", "deg/s"]


def pitch_flight(folder: Path) -> Path:
    """Pitch rate and angle of attack (SI) after a sweep of the elevator in deg, without units."""
    time = np.arange(0.0, 60.0, 0.02)
    elevator = 2.0 * signal.chirp(time, 0.1, 60.0, 3.0)
    rng = np.random.default_rng(1)
    q, alpha = (
        signal.lsim((top, [1.0, 6.0, 30.0]), np.radians(elevator), time)[1]
        + rng.normal(0.0, 0.002, time.size)
        for top in ([-27.0, -50.0], [-27.0])
    )
    return write_csv(folder, time=time, elevator=elevator, q=q, alpha=alpha)


def test_an_elevator_in_degrees_without_a_unit_is_warned_of(tmp_path: Path) -> None:
    found = fid.frequency_response(pitch_flight(tmp_path), "elevator", "q")
    assert any("channel elevator: moves by 2" in each for each in found.warnings)
    channels = {"elevator": {"column": "elevator", "unit": "deg"}}
    right = fid.frequency_response(tmp_path / "flight.csv", "elevator", "q", channels=channels)
    assert not any("moves by" in each for each in right.warnings)


def test_a_gain_has_the_unit_of_the_response_and_alpha_no_qualities_of_a_pitch_rate(
    tmp_path: Path,
) -> None:
    channels = {"elevator": {"column": "elevator", "unit": "deg"}}
    found = fid.frequency_response(
        pitch_flight(tmp_path), "elevator", ["q", "alpha"], channels=channels, fit="pitch"
    ).to_dict()
    rate, angle = (each["parameters"] for each in found["fits"]["functions"])
    assert rate["gain"]["unit"] == "rad/s2 per rad" and rate["gain"]["value"] < 0.0
    assert (angle["gain"]["unit"], rate["inv_T_theta2"]["unit"]) == ("1/s", "1/s")
    assert [each["output"] for each in found["flying_qualities"]] == ["q"]
    assert any("the form pitch is that of a pitch rate" in each for each in found["warnings"])


def feedback_flight(folder: Path) -> Path:
    rng = np.random.default_rng(5)
    step, count = 0.02, 12000
    top, bottom, _ = signal.cont2discrete(([6.0, 7.2], [1.0, 3.2, 16.0]), step, "zoh")
    top = np.ravel(top)
    r = signal.lfilter(*signal.butter(2, 0.12), rng.standard_normal(count))
    n = 0.9 * signal.lfilter(*signal.butter(1, 0.04), rng.standard_normal(count))
    closed = np.polyadd(bottom, 0.5 * top)
    y = signal.lfilter(top, closed, r) + signal.lfilter(bottom, closed, n)
    return write_csv(folder, time=step * np.arange(count), sweep=r, surface=r - 0.5 * y, rate=y)


def test_feedback_is_answered_by_a_reference(tmp_path: Path) -> None:
    path = feedback_flight(tmp_path)
    joint = fid.frequency_response(path, "surface", "rate", reference="sweep", band=(0.1, 2.0))
    assert joint.to_dict()["method"] == "joint input-output"
    assert any("the direct estimate is biased by feedback" in each for each in joint.warnings)
    z = np.exp(2j * math.pi * joint.frequency * 0.02)
    top, bottom, _ = signal.cont2discrete(([6.0, 7.2], [1.0, 3.2, 16.0]), 0.02, "zoh")
    truth = np.polyval(np.ravel(top), z) / np.polyval(bottom, z)
    inside = np.abs(joint.response[0, 0] - truth) <= joint.details.responses.radius()[0, 0]
    assert np.mean(inside) > 0.85
    direct = fid.frequency_response(path, "surface", "rate", band=(0.1, 2.0))
    outside = np.abs(direct.response[0, 0] - truth) > direct.details.responses.radius()[0, 0]
    assert np.mean(outside) > 0.2  # where chance leaves 0.05


def test_two_inputs_that_move_together_say_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    a = signal.lfilter(*signal.butter(2, 0.1), rng.standard_normal(9000))
    b = a + 0.5 * signal.lfilter(*signal.butter(2, 0.1), rng.standard_normal(9000))
    y = a - 2.0 * b + 0.1 * rng.standard_normal(9000)
    path = write_csv(tmp_path, time=0.02 * np.arange(9000), left=a, right=b, y=y)
    found = fid.frequency_response(path, ["left", "right"], "y", band=(0.1, 2.0))
    assert any("mean coherence" in each for each in found.warnings)
    np.testing.assert_allclose(found.response[0, 0], 1.0, atol=0.3)
    np.testing.assert_allclose(found.response[0, 1], -2.0, atol=0.3)
    alone = fid.frequency_response(path, "right", "y", band=(0.1, 2.0))
    assert abs(np.median(alone.response.real) + 1.2) < 0.15  # the other input's share goes to it


def test_parts_of_a_record_are_pooled_and_gaps_part_it(tmp_path: Path) -> None:
    time, target, rate = chirp_flight(7)
    time = time[::8].copy()
    time[time.size // 2 :] += 3.0
    path = write_csv(tmp_path, time=time, a=target[::8], b=rate[::8])
    found = fid.frequency_response(path, "a", "b", band=(0.5, 5.0))
    assert len(found.to_dict()["parts"]) == 2 and "a gap" in found.summary()
    parts = fid.frequency_response(path, "a", "b", band=(0.5, 5.0), start=[5, 40], stop=[25, 60])
    assert len(parts.to_dict()["parts"]) == 2


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "--input: no signal is named"),
        (["--input", "a"], "--output: no signal is named"),
        (["--input", "a", "--output", "a"], "a is named twice"),
        (["--input", "a", "--output", "c"], "'c'"),
        (["--input", "x", "--output", "b"], "'x'"),
        (["--input", "time", "--output", "b"], "time is no signal"),
        (["--input", "a", "--output", "flat"], "it does not move"),
        (["--input", "a", "--output", "b", "--band", "2", "1"], "2 to 1 Hz is no band"),
        (["--input", "a", "--output", "b", "--band", "0.001", "1"], "is below"),
        (["--input", "a", "--output", "b", "--band", "1", "40"], "above 0.45 of the rate"),
        (["--input", "a", "--output", "b", "--window", "-3"], "no length"),
        (["--input", "a", "--output", "b", "--window", "900"], "no window is as short"),
        (["--input", "a", "--output", "b", "--tapers", "1"], "1 tapers"),
        (["--input", "a", "--output", "b", "--window", "5", "--tapers", "5"], "two ways"),
        (["--input", "a", "--output", "b", "--coherence", "1.5"], "no coherence"),
        (["--input", "a", "--output", "b", "--reference", "b"], "b is named twice"),
        (["--input", "a", "--output", "b", "--from", "1", "--to", "1.5"], "too few"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    time, target, rate = chirp_flight()
    path = write_csv(
        tmp_path, time=time[::8], a=target[::8], b=rate[::8], flat=np.ones(time[::8].size)
    )
    out = tmp_path / "bode"
    assert typed("response", path, *words, "--out", out) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err
    assert not out.exists()


@pytest.mark.long
def test_from_a_log_to_a_transfer_function_in_three_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = write_log(tmp_path), tmp_path / "roll"
    signals = ("--input", "SIDD.Targ", "--output", "SIDD.Gx")
    assert typed("map", log) == 0
    drafted = capsys.readouterr().out
    # The target of the sweep is no elevator, whatever the model.
    assert "elevator = " not in drafted.split("# Not found")[0]
    assert f"flightid response {log.name} {' '.join(signals)} --out bode" in drafted
    assert typed("response", log, *signals) == 0
    assert typed("response", log, *signals, "--fit", "roll", "--out", out) == 0
    printed = capsys.readouterr().out
    assert "inv_T_roll" in printed and "within the envelopes" in printed
    (one,) = json.loads((out / "responses.json").read_text())["fits"]["functions"]
    # The lag that is simulated answers half a sample before the continuous one.
    exact_values = {"gain": GAIN / LAG, "inv_T_roll": 1 / LAG, "delay": DELAY - 0.5 / RATE}
    for name, value in exact_values.items():
        each = one["parameters"][name]
        assert abs(each["value"] - value) < 3.0 * each["std"] < 0.05 * value, name
    assert one["unnoticeable"] is True and one["cost"] < 5.0
    assert (out / "mismatch.png").is_file() and "Transfer functions" in (
        out / "report.html"
    ).read_text()


@pytest.mark.long
def test_a_delay_that_may_be_none_is_said_and_is_no_rounding_in_print(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = 0.01 * np.arange(6000)
    stick = np.sin(2.0 * np.pi * (0.05 * time + 0.02 * time**2))
    _, rate, _ = signal.lsim(signal.TransferFunction([8.0, 6.0], [1.0, 3.2, 6.5]), stick, time)
    path = write_csv(
        tmp_path,
        time=time,
        a=stick,
        b=rate + 0.01 * np.random.default_rng(2).standard_normal(time.size),
    )
    asked = ("response", path, "--input", "a", "--output", "b", "--fit", "pitch")
    assert typed(*asked) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "the delay is" in printed and "which may be none; --fix delay=0 leaves it out" in printed
    assert "e-1" not in printed and "e+1" not in printed
    assert typed(*asked, "--fix", "delay=0") == 0
    assert "may be none" not in capsys.readouterr().out


def test_fits_in_python(tmp_path: Path) -> None:
    time, target, rate = chirp_flight(8)
    lead = signal.lfilter([1.0 - 0.8], [1.0, -0.8], rate)
    path = write_csv(tmp_path, time=time[::8], a=target[::8], b=rate[::8], c=lead[::8])
    found = fid.frequency_response(
        path, "a", ["b", "c"], band=(0.2, 6.0), fit={"b": "0/1"}, fix={"delay": 0.01875}
    )
    (one,) = found.to_dict()["fits"]["functions"]
    assert one["output"] == "b" and one["fixed"] == {"delay": 0.01875} and "unnoticeable" not in one
    assert one["parameters"]["a0"]["value"] == pytest.approx(1 / LAG, rel=0.02)
    exact_lag = found.to_transfer_function("b", pade=0)
    assert exact_lag.poles()[0].real == pytest.approx(-1 / LAG, rel=0.02)
    late = np.squeeze(found.to_transfer_function("b", pade=4)(2j * math.pi))
    assert abs(late / exact(np.array([1.0]))[0] - 1.0) < 0.02
    assert found.plot.mismatch().axes
    with pytest.raises(fid.InputError, match="no transfer function is fitted"):
        found.to_transfer_function("c")
    with pytest.raises(fid.InputError, match="no transfer function is fitted"):
        found.plot.mismatch(1)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--fit", "pich"], "there is no form 'pich'"),
        (["--fit", "2/1"], "orders 2 and 1"),
        (["--fit", "c=roll"], "there is no output 'c'"),
        (["--fit", "roll", "--fit", "pitch"], "two forms for b"),
        (["--fix", "delay=0"], "--fix: no form is named"),
        (["--shared-poles"], "--shared-poles: no form is named"),
        (["--pilot", "3.5"], "--pilot: a pilot needs an attitude"),
        (["--pilot-delay", "0.2"], "--pilot-delay: there is no pilot"),
        (["--vehicle", "v.toml"], "--vehicle: no model is named"),
        (["--fit", "roll", "--fix", "delay"], "fixes nothing"),
        (["--fit", "roll", "--fix", "zeta=1"], "no form has a parameter 'zeta'"),
        (["--fit", "0/1", "--fix", "a0=1", "--fix", "b0=1", "--fix", "delay=0"], "nothing is free"),
    ],
)
def test_bad_fits_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    time, target, rate = chirp_flight()
    path = write_csv(tmp_path, time=time[::8], a=target[::8], b=rate[::8])
    out = tmp_path / "bode"
    assert typed("response", path, "--input", "a", "--output", "b", *words, "--out", out) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err
    assert not out.exists()


@pytest.mark.long
def test_flying_qualities_of_a_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = write_log(tmp_path), tmp_path / "roll"
    signals = ("--input", "SIDD.Targ", "--output", "SIDD.Gx")
    assert typed("response", log, *signals, "--bandwidth", "rate", "--out", out) == 0
    printed = capsys.readouterr().out
    assert "phase bandwidth" in printed and "no phase delay" in printed
    assert "with 95 % intervals" in printed
    (one,) = json.loads((out / "responses.json").read_text())["flying_qualities"]
    omega = one["phase_bandwidth"]["value"]
    attitude = np.degrees(np.angle(exact(np.array([omega / (2.0 * math.pi)])) / (1j * omega)))
    assert attitude[0] == pytest.approx(-135.0, abs=1.0)
    assert (out / "bandwidth.png").is_file() and "Flying qualities" in (
        out / "report.html"
    ).read_text()
    found = fid.frequency_response(log, "SIDD.Targ", "SIDD.Gx", bandwidth="rate")
    name, qualities = found.flying_qualities.popitem()
    assert name == "SIDD.Gx/SIDD.Targ" and qualities["phase_bandwidth"][0] == omega
    assert found.plot.bandwidth().axes
    with pytest.raises(fid.InputError, match="no bandwidth to draw"):
        fid.frequency_response(log, "SIDD.Targ", "SIDD.Gx").plot.bandwidth()
    assert typed("response", log, *signals, "--bandwidth", "speed") == 2
    assert "there is no kind 'speed'" in capsys.readouterr().err


def test_limits_of_pitch_are_drawn_and_judged_for_pitch_alone(tmp_path: Path) -> None:
    """The chart of a roll response had the limits that MIL-STD-1797A gives for pitch."""
    time, target, roll = swept()
    path = write_csv(tmp_path, "sweep.csv", time=time, target=target, roll=roll, p=roll, q=roll)
    cases: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("roll", {"fit": "roll"}, "no limits drawn"),
        ("p", {}, "no limits drawn"),
        ("roll", {}, "if this is pitch"),
        ("q", {}, "pitch: MIL-STD-1797A, category A (not verified)"),
    )
    for output, fit, named in cases:
        found = fid.frequency_response(
            path, "target", output, bandwidth="rate", pilot=3.0, band=(0.1, 8.0), **fit
        )
        (one,) = found.details.qualities
        figure = found.plot.qualities()
        words = [text.get_text() for axes in figure.axes for text in axes.texts]
        told = [axes.get_title(loc="left") for axes in figure.axes] + words
        assert any(named in each for each in told), told
        assert any("limit of level" in each for each in words) is (one.of_pitch is not False)
        levels = [level for level in chart_levels(one) if level.name == "pilot_resonance"]
        assert bool(levels) is (one.of_pitch is not False)
        unknown = one.of_pitch is None
        assert all((", if this is pitch" in each.words) is unknown for each in levels)


def test_parts_have_the_names_of_files_and_not_of_their_json(tmp_path: Path) -> None:
    """`study train, ...` was printed of pitch.csv: the name inside pitch.json."""
    time, target, roll = swept()
    path = write_csv(tmp_path, "sweep.csv", time=time, target=target, roll=roll)
    about = {"schema": "flightid/record/1", "name": "train"}
    path.with_suffix(".json").write_text(json.dumps(about))
    found = fid.frequency_response(path, "target", "roll", band=(0.5, 5.0))
    assert found.summary().splitlines()[0].startswith("study     sweep.csv")
    parts = fid.frequency_response(
        path, "target", "roll", band=(0.5, 5.0), start=[5, 40], stop=[30, 80]
    )
    assert "train" not in parts.summary() and "train" not in json.dumps(parts.to_dict()["parts"])


def test_records_of_a_call_are_of_one_kind(tmp_path: Path) -> None:
    time, target, rate = chirp_flight()
    first = write_csv(tmp_path, "one.csv", time=time[::8], a=target[::8], b=rate[::8])
    slow = write_csv(tmp_path, "slow.csv", time=time[::16], a=target[::16], b=rate[::16])
    with pytest.raises(fid.InputError, match=r"25 samples a second, and 50 in one.csv.*rate="):
        fid.frequency_response([first, slow], "a", "b", band=(0.2, 5.0))
    both = fid.frequency_response([first, slow], "a", "b", band=(0.2, 5.0), rate=20.0)
    assert len(both.to_dict()["parts"]) == 2
    other = tmp_path / "other.csv"
    other.write_text(first.read_text().replace("time,a,b", "time,a,b [deg/s]", 1))
    with pytest.raises(fid.InputError, match=r"b is in deg/s, and in no unit in one.csv"):
        fid.frequency_response([first, other], "a", "b", band=(0.2, 5.0))


def test_a_band_that_the_input_does_not_reach_is_said(tmp_path: Path) -> None:
    """A sweep to 2 Hz: above, smooth signals are coherent by what leaks, and the response wrong."""
    time = 0.02 * np.arange(3000)
    stick = signal.chirp(time, 0.1, 60.0, 2.0, method="logarithmic", phi=-90.0)
    rate = signal.lsim(([6.0], [1.0, 3.0]), stick, time)[1]
    flight = pd.DataFrame({"time": time, "stick": stick, "rate": rate})
    wide = fid.frequency_response(flight, "stick", "rate", band=(0.2, 10.0))
    assert any("stick has hardly any power between" in each for each in wide.warnings)
    swept = fid.frequency_response(flight, "stick", "rate", band=(0.2, 1.8))
    assert not any("hardly any power" in each for each in swept.warnings)


def test_proportional_inputs_are_refused(tmp_path: Path) -> None:
    time, target, rate = chirp_flight()
    path = write_csv(tmp_path, time=time[::8], a=target[::8], twice=2.0 * target[::8], b=rate[::8])
    with pytest.raises(fid.InputError, match="follows from the other inputs"):
        fid.frequency_response(path, ["a", "twice"], "b", band=(0.2, 5.0))


def loop_flight(seed: int, duration: float = 60.0, sign: float = -1.0) -> dict[str, Any]:
    """Signals at 80 Hz of the X-29-like loop under a sweep of its command."""
    x29 = load_x29("F")
    time = x29.frame * np.arange(int(duration / x29.frame))
    sweep = 0.5 * signal.chirp(time, 0.15, duration, 10.0, method="logarithmic")
    _, command, returned, _, _ = loop_test(x29, sweep, np.random.default_rng(seed))
    return {"time": time, "sweep": sweep, "command": command, "returned": -sign * returned}


LOOP_WORDS = (
    "--input",
    "command",
    "--output",
    "returned",
    "--reference",
    "sweep",
    "--band",
    "0.2",
    "10",
)


@pytest.mark.long
def test_stability_margins_of_pooled_flights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [write_csv(tmp_path, f"flight{n}.csv", **loop_flight(n)) for n in (1, 2, 3)]
    out = tmp_path / "loop"
    assert typed("response", *paths, *LOOP_WORDS, "--margins", "minus", "--out", out) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "phase margin" in printed and "The worst maneuver" in printed
    assert (
        "gain increase of 6 dB not met" in printed and "phase margin of 45 deg not met" in printed
    )
    exact = margins(load_x29("F"))
    written = json.loads((out / "responses.json").read_text())["margins"]
    pooled = written["pooled"]
    for name, value in (("gain_increase", exact.gain_increase), ("phase_margin", exact.phase)):
        assert pooled[name]["low"] < value < pooled[name]["high"]
        assert pooled[name]["high"] - pooled[name]["low"] < 0.1 * abs(value)
    phases = [each["phase_margin"]["value"] for each in written["maneuvers"]]
    assert written["worst"]["phase_margin"]["value"] == min(phases)
    assert (
        written["worst"]["phase_margin"]["maneuver"]
        == written["maneuvers"][int(np.argmin(phases))]["name"]
    )
    assert (out / "loop.png").is_file() and "Stability margins" in (out / "report.html").read_text()
    found = fid.frequency_response(
        paths, "command", "returned", reference="sweep", band=(0.2, 10.0), margins="minus"
    )
    assert found.margins["phase_margin"]["value"] == pooled["phase_margin"]["value"]
    assert found.worst_margins["phase_margin"] == written["worst"]["phase_margin"]
    assert found.plot.loop().axes


def test_records_of_one_name_are_told_apart_by_their_files(tmp_path: Path) -> None:
    """Two flights that were made by the same program, whose JSON files give them one name."""
    paths = []
    for n in (1, 2):
        paths.append(write_csv(tmp_path, f"flight{n}.csv", **loop_flight(n, 40.0)))
        about = {"schema": "flightid/record/1", "name": "flight 1"}
        paths[-1].with_suffix(".json").write_text(json.dumps(about))
    found = fid.frequency_response(
        paths, "command", "returned", reference="sweep", band=(0.5, 8.0), margins="minus"
    )
    assert found.worst_margins["phase_margin"]["maneuver"] in ("flight1.csv", "flight2.csv")


def swept(late: float = 0.035, seed: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """90 s at 100 Hz of a sweep, and its answer by a lag of 0.08 s with a delay of whole steps."""
    time = 0.01 * np.arange(9000)
    target = 20.0 * signal.chirp(time, 0.1, 90.0, 8.0, method="logarithmic")
    shift = round(late / 0.01)
    moved = np.concatenate([np.zeros(shift), target])[: time.size]
    decay = math.exp(-0.01 / 0.08)
    roll = 0.9 * signal.lfilter([1.0 - decay], [1.0, -decay], moved)
    return time, target, roll + np.random.default_rng(seed).normal(0.0, 1.0, time.size)


def fitted_roll(folder: Path, roll: np.ndarray, late: float = 0.035) -> Any:
    time, target, _ = swept(late)
    path = write_csv(folder, "sweep.csv", time=time, target=target, roll=roll)
    return fid.frequency_response(path, "target", "roll", fit="roll")


def test_a_dropout_of_an_output_parts_the_record(tmp_path: Path) -> None:
    """A line through three lost seconds was answered like a flight without a motion."""
    roll = swept()[2]
    whole = fitted_roll(tmp_path, roll).details.fits.fit.functions[0]
    roll[3000:3300] = np.nan
    found = fitted_roll(tmp_path, roll)
    assert [round(each) for each in found.details.durations] == [30, 57]
    one = found.details.fits.fit.functions[0]
    assert one.values["inv_T_roll"] == pytest.approx(whole.values["inv_T_roll"], rel=0.03)
    assert one.values["delay"] == pytest.approx(whole.values["delay"], abs=0.002)


def test_an_output_in_every_fifth_row_is_taken_at_its_own_rate(tmp_path: Path) -> None:
    roll = swept()[2]
    roll[np.arange(roll.size) % 5 != 0] = np.nan
    found = fitted_roll(tmp_path, roll)
    assert any("a sample every 0.05 s" in note for note in found.details.notes)
    assert found.details.fits.fit.functions[0].values["inv_T_roll"] == pytest.approx(12.5, rel=0.05)


@pytest.mark.parametrize("late", [0.4, 0.6])
def test_a_long_delay_is_found(tmp_path: Path, late: float) -> None:
    found = fitted_roll(tmp_path, swept(late)[2], late).details.fits.fit.functions[0]
    assert found.cost < 10.0 and found.values["delay"] == pytest.approx(late - 0.005, abs=0.005)


def test_no_level_lies_below_a_delay_of_zero(tmp_path: Path) -> None:
    """The lower end of the interval of a delay that is none was worse than level 3."""
    time, target, _ = swept()
    roll = signal.lsim(([9.0], [1.0, 9.0]), target, time)[1]
    roll = roll + np.random.default_rng(6).normal(0.0, 0.3, time.size)
    path = write_csv(tmp_path, "sweep.csv", time=time, target=target, roll=roll)
    found = fid.frequency_response(path, "target", "roll", fit="roll", levels="IV-A")
    (late,) = [
        each for each in found.details.qualities[0].levels if each.quality.name == "total_delay"
    ]
    assert late.quality.value < 2.0 * late.quality.std
    assert (late.level, late.best, late.worst) == (1, 1, 1)


def test_a_fitted_mode_outside_the_usable_band_is_said(tmp_path: Path) -> None:
    """The coherence dips at a lightly damped mode, and the usable band begins above it."""
    time, target, _ = swept()
    y = signal.lsim(([9.0], [1.0, 0.18, 9.0]), target / 20.0, time)[1]
    y = y + np.random.default_rng(7).normal(0.0, 0.05, time.size)
    path = write_csv(tmp_path, "light.csv", time=time, target=target / 20.0, y=y)
    found = fid.frequency_response(path, "target", "y", fit="dutch-roll")
    band, fits = found.details.responses.bands()[0][0], found.details.fits
    assert band is not None and fits is not None
    low = 2.0 * math.pi * band[0]
    mode = fits.fit.functions[0].values["frequency"]
    assert mode < low
    assert any("lies outside the usable band" in each for each in found.warnings)


def test_the_wrong_sign_of_a_loop_is_not_compared(tmp_path: Path) -> None:
    path = write_csv(tmp_path, "loop.csv", **loop_flight(1))
    found = fid.frequency_response(
        path, "command", "returned", reference="sweep", band=(0.2, 10.0), margins="plus"
    )
    loop = found.details.loop
    assert (
        loop is not None and loop.contradicted and "fits these signals" in " ".join(loop.cautions)
    )
    assert not any("45 deg met" in line for line in margin_lines(loop))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"band": 5}, "5 is no band"),
        ({"input": 3}, "3 names no signal"),
        ({"fit": "roll", "fix": {"delay": "a"}}, "fixes nothing"),
        ({"fit": "roll", "fix": {"delay": math.nan}}, "not finite"),
        ({"fit": "roll", "fix": {"delay": -1}}, "a delay of -1 s"),
    ],
)
def test_wrong_arguments_in_python_are_one_line(
    tmp_path: Path, given: dict[str, Any], said: str
) -> None:
    time, target, roll = swept()
    path = write_csv(tmp_path, "sweep.csv", time=time, target=target, roll=roll)
    with pytest.raises(fid.InputError, match=said):
        fid.frequency_response(path, **({"input": "target", "output": "roll"} | given))


def test_a_loop_that_adds_has_the_same_margins(tmp_path: Path) -> None:
    one, other = loop_flight(4), loop_flight(4, sign=1.0)
    wanted: dict[str, Any] = {"reference": "sweep", "band": (0.2, 10.0)}
    minus = fid.frequency_response(one, "command", "returned", margins="minus", **wanted)
    plus = fid.frequency_response(other, "command", "returned", margins="plus", **wanted)
    assert minus.margins["phase_margin"]["value"] == pytest.approx(
        plus.margins["phase_margin"]["value"], rel=1e-9
    )
    assert not any("margins=" in line for line in (*minus.warnings, *plus.warnings))
    wrong = fid.frequency_response(other, "command", "returned", margins="minus", **wanted)
    assert any('margins="plus" fits these signals' in line for line in wrong.warnings)


def test_margins_without_an_excitation_say_that_they_are_biased() -> None:
    found = fid.frequency_response(
        loop_flight(5), "command", "returned", band=(0.3, 10.0), margins="minus"
    )
    assert any("margins from the direct estimate" in line for line in found.warnings)
    plain = fid.frequency_response(loop_flight(5), "command", "returned", band=(0.3, 10.0))
    assert plain.margins == {} and plain.worst_margins == {}
    with pytest.raises(fid.InputError, match="no margins to draw"):
        plain.plot.loop()


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--input", "command", "--output", "returned", "--margins", "times"],
            "there is no sign 'times'",
        ),
        (
            [
                "--input",
                "command",
                "--output",
                "returned",
                "--output",
                "sweep",
                "--margins",
                "minus",
            ],
            "are no single loop",
        ),
        (
            ["--input", "command", "--input", "sweep", "--output", "returned", "--margins", "plus"],
            "2 inputs and 1 outputs",
        ),
    ],
)
def test_bad_loops_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    path = write_csv(tmp_path, **loop_flight(1))
    assert typed("response", path, *words) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err


@pytest.mark.long
def test_levels_of_fitted_forms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, target, rate = chirp_flight()
    path, out = write_csv(tmp_path, time=time[::8], a=target[::8], b=rate[::8]), tmp_path / "roll"
    words = ("--input", "a", "--output", "b", "--fit", "roll", "--levels", "IV-A")
    assert typed("response", path, *words, "--out", out) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert (
        "Flying qualities of b/a" in printed
        and "roll time constant: level 1 (MIL-F-8785C 3.3.1.2, table VII)" in printed
    )
    (one,) = json.loads((out / "responses.json").read_text())["flying_qualities"]
    assert one["roll_time_constant"]["value"] == pytest.approx(LAG, rel=0.05)
    assert {each["quantity"]: each["level"] for each in one["levels"]} == {
        "roll_time_constant": 1,
        "total_delay": 1,
    }
    found = fid.frequency_response(path, "a", "b", fit="roll", levels="IV-A")
    assert found.levels["b/a"]["roll_time_constant"] == (1, 1, 1)
    pitch = fid.frequency_response(path, "a", "b", fit="pitch", airspeed=90.0)
    assert "control_anticipation" in pitch.flying_qualities["b/a"] and pitch.levels == {}


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--levels", "V-A"], "'V-A' is no class and category"),
        (["--levels", "IV"], "'IV' is no class and category"),
        (["--levels", "IV-A"], "no form is fitted"),
        (["--fit", "0/1", "--levels", "IV-A"], "no form is fitted"),
        (["--airspeed", "90"], "no pitch rate is fitted"),
        (["--fit", "pitch", "--airspeed", "-1"], "no airspeed"),
    ],
)
def test_bad_levels_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    time, target, rate = chirp_flight()
    path = write_csv(tmp_path, time=time[::8], a=target[::8], b=rate[::8])
    assert typed("response", path, "--input", "a", "--output", "b", *words) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err
