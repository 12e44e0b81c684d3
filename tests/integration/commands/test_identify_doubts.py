"""What `flightid identify` says against its own result: another reading of the inputs, the weight
along the flight path, impossible derivatives.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ident.estimate import Outcome
from sim.declaration.compile import compile_model
from tests.bases import fly, rigid_flight, rigid_model
from tests.independent.short_period import BUSINESS_JET, Hidden, flown
from tests.integration.command_line import CommandLine
from tests.jet_record import LONG, NOISE, recorded, vehicle_file
from tests.rigid_problem import noisy
from tests.unstable_flight import DERIVATIVES, FIGHTER, flown_in_a_loop


def identified(
    flightid: CommandLine, folder: Path, record: Path, *options: object
) -> tuple[str, dict[str, Any]]:
    told = flightid.done(
        "identify",
        record,
        "--model",
        "rigid",
        "--vehicle",
        folder / "v.toml",
        "--no-figures",
        "--out",
        folder / "out",
        *options,
    )
    content: dict[str, Any] = json.loads((folder / "out" / "comparison.json").read_text())
    return told, content


@pytest.mark.long
def test_both_readings_of_the_inputs_are_shown_where_they_differ(
    flightid: CommandLine, tmp_path: Path
) -> None:
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    record = recorded(tmp_path / "flight.csv", Hidden(), every=40)
    told, content = identified(flightid, tmp_path, record)
    by_hand = {
        hold: identified(flightid, tmp_path, record, "--hold", hold)[1]
        for hold in ("linear", "previous")
    }
    assert all("input_reading" not in each for each in by_hand.values()), (
        "who chose a reading is not asked again"
    )
    reading = content["input_reading"]
    assert {reading["used"], reading["other"]} == {"linear", "previous"}
    first, second = (by_hand[reading[key]]["parameters"] for key in ("used", "other"))
    apart = {
        name
        for name, row in first.items()
        if abs(second[name]["estimate"] - row["estimate"]) > row["std"]
    }
    assert set(reading["parameters"]) == apart and "Cm_q" in apart
    for name, entry in reading["parameters"].items():
        for hold in ("linear", "previous"):
            shown = by_hand[hold]["parameters"][name]
            assert entry[hold]["estimate"] == pytest.approx(shown["estimate"], rel=1e-9) and entry[
                hold
            ]["std"] == pytest.approx(shown["std"], rel=1e-9)
    # The data decide: one sentence, no table of what the wrong reading gives, no warning.
    assert "moved by" not in told and "changes by more" not in " ".join(told.split())
    assert (
        content["warnings"] == []
        and sum("inputs linear between samples" in note for note in content["notes"]) == 1
    )


def test_readings_that_the_data_do_not_distinguish_are_shown_in_a_table(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """Under fifty times the noise the likelihood does not choose, while the reading moves
    derivatives by more than a sigma.
    """
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    path = recorded(tmp_path / "flight.csv", Hidden(), every=40)
    rows, rng = np.loadtxt(path, delimiter=",", skiprows=1), np.random.default_rng(2)
    rows[:, 2:] += 50.0 * np.array([*NOISE.values()])[:3] * rng.standard_normal((len(rows), 3))
    np.savetxt(
        path, rows, delimiter=",", header="time,elevator,alpha,q,nz", comments="", fmt="%.12g"
    )
    told, content = identified(flightid, tmp_path, path)
    assert (
        "derivative" in told
        and "moved by" in told
        and "changes by more than one sigma" in " ".join(told.split())
    )
    assert any("changes by more" in warning for warning in content["warnings"])
    assert abs(2.0 * content["input_reading"]["log_likelihood_gain"]) < 10.0


def test_nothing_is_said_of_readings_that_do_not_matter(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    """A file that states its reading is not asked for the other one."""
    flightid.done(
        "identify",
        rigid_folder / "record.csv",
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--no-figures",
        "--out",
        tmp_path,
    )
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert "input_reading" not in content and content["warnings"] == []


@pytest.mark.long
def test_a_measured_attitude_takes_the_weight_along(flightid: CommandLine, tmp_path: Path) -> None:
    """With speed and height exchanging, what an attitude tells brings derivatives nearer to the
    truth by several of their sigmas.
    """
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    hidden = Hidden(exchange=True, climb=0.05)
    blind = identified(
        flightid, tmp_path, recorded(tmp_path / "blind.csv", hidden), "--hold", "linear"
    )[1]
    record = recorded(tmp_path / "flight.csv", hidden, ("alpha", "q", "nz", "theta"))
    content = identified(flightid, tmp_path, record, "--hold", "linear")[1]
    assert any(
        "the weight along the flight path changes speed and loads" in note
        for note in content["notes"]
    )
    assert set(content["parameters"]) == set(blind["parameters"]) == set(BUSINESS_JET.derivatives)

    def worst(some: dict[str, Any], std: dict[str, Any]) -> float:
        true, known = BUSINESS_JET.derivatives, std["parameters"]
        return max(
            abs(row["estimate"] - true[name]) / known[name]["std"]
            for name, row in some["parameters"].items()
        )

    assert worst(content, content) < 0.5 * worst(blind, content)
    assert content["noise_std"]["nz"] < 0.5 * blind["noise_std"]["nz"]


@pytest.mark.long
def test_at_constant_speed_a_measured_attitude_changes_nothing(
    flightid: CommandLine, tmp_path: Path
) -> None:
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    blind = identified(
        flightid, tmp_path, recorded(tmp_path / "blind.csv", Hidden()), "--hold", "linear"
    )[1]
    flight = flown(BUSINESS_JET, LONG, 0.02, Hidden())
    table = np.loadtxt(tmp_path / "blind.csv", delimiter=",", skiprows=1)
    theta = flight.theta[::16] + 5e-4 * np.random.default_rng(2).standard_normal(len(table))
    np.savetxt(
        tmp_path / "flight.csv",
        np.column_stack([table, theta]),
        delimiter=",",
        header="time,elevator,alpha,q,nz,theta",
        comments="",
        fmt="%.12g",
    )
    content = identified(flightid, tmp_path, tmp_path / "flight.csv", "--hold", "linear")[1]
    assert any("measured and not used" in note for note in content["notes"])
    assert content["parameters"] == blind["parameters"]


@pytest.mark.long
def test_a_derivative_of_impossible_sign_is_named_in_one_line(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """An elevator recorded with the other sign: both control derivatives turn."""
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    table = np.loadtxt(recorded(tmp_path / "flight.csv", Hidden()), delimiter=",", skiprows=1)
    table[:, 1] *= -1.0
    np.savetxt(
        tmp_path / "turned.csv",
        table,
        delimiter=",",
        header="time,elevator,alpha,q,nz",
        comments="",
        fmt="%.12g",
    )
    told, content = identified(
        flightid, tmp_path, tmp_path / "turned.csv", "--hold", "linear", "--trust-record"
    )
    said = [warning for warning in content["warnings"] if "implausible" in warning]
    assert (
        len(said) == 1
        and "CL_de" in said[0]
        and "Cm_de" in said[0]
        and "has the other sign" in said[0]
        and "CL_alpha" not in said[0]
    )
    assert " ".join(told.split()).count("implausible") == 1
    right = identified(flightid, tmp_path, tmp_path / "flight.csv", "--hold", "linear")[1]
    assert not any("implausible" in warning for warning in right["warnings"])


@pytest.mark.long
def test_each_segment_has_a_flight_path_of_its_own(flightid: CommandLine, tmp_path: Path) -> None:
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    record = recorded(
        tmp_path / "flight.csv", Hidden(exchange=True, climb=0.05), ("alpha", "q", "nz", "theta")
    )
    content = identified(
        flightid,
        tmp_path,
        record,
        "--hold",
        "linear",
        "--from",
        0,
        "--to",
        12,
        "--from",
        13,
        "--to",
        27,
    )[1]
    assert len(content["segments"]) == 2 and content["outcome"] == "converged"
    assert any(
        "the weight along the flight path changes speed and loads" in note
        for note in content["notes"]
    )
    true = BUSINESS_JET.derivatives
    assert all(
        abs(row["estimate"] - true[name]) < 0.1 * abs(true[name]) + 4.0 * row["std"]
        for name, row in content["parameters"].items()
    )


@pytest.mark.long
@pytest.mark.parametrize("method", ["output-error", "filter-error"])
def test_an_unstable_aircraft_is_identified_and_its_pieces_are_told(
    flightid: CommandLine, tmp_path: Path, method: str
) -> None:
    record = flown_in_a_loop(np.random.default_rng(4))
    columns = {"time": record.time, **{channel.name: channel.values for channel in record.channels}}
    np.savetxt(
        tmp_path / "flight.csv",
        np.array([*columns.values()]).T,
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.12g",
    )
    starts = [f"{name} = {0.7 * value}" for name, value in FIGHTER.items() if name in DERIVATIVES]
    constants = [f"{name} = {value}" for name, value in FIGHTER.items() if name not in DERIVATIVES]
    (tmp_path / "v.toml").write_text(
        "\n".join(['name = "fighter"', *constants, "[derivatives]", *starts])
    )
    content = identified(
        flightid, tmp_path, tmp_path / "flight.csv", "--hold", "previous", "--method", method
    )[1]
    assert content["outcome"] == "converged" and content["warnings"] == []
    assert any(
        "the motion is unstable: the records are cut into 2 pieces" in note
        for note in content["notes"]
    )
    assert all(
        abs(content["parameters"][name]["estimate"] - FIGHTER[name])
        < 4.0 * content["parameters"][name]["std"]
        for name in DERIVATIVES
    )


@pytest.mark.long
def test_a_degenerate_fit_is_no_result_and_says_what_to_do(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """An angle of attack that was computed by the very model, not measured: nothing of its noise is
    left to weigh it by.
    """
    vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    names = ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
    model = rigid_model(
        {**{name: getattr(BUSINESS_JET, name) for name in names}, **BUSINESS_JET.derivatives}
    )
    flight = rigid_flight(8.0, 50.0)
    record, clean = (
        noisy(model, flight, np.random.default_rng(1)),
        fly(compile_model(model), flight)[0],
    )
    columns = {
        "time": record.time,
        **{channel.name: channel.values for channel in record.channels},
        "alpha": clean,
    }
    np.savetxt(
        tmp_path / "exact.csv",
        np.array([*columns.values()]).T,
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.15g",
    )
    told, content = identified(
        flightid,
        tmp_path,
        tmp_path / "exact.csv",
        "--hold",
        "previous",
        "--method",
        "filter-error",
        "--trust-record",
    )
    assert content["outcome"] == "degenerate"
    assert (
        any(Outcome.DEGENERATE.hint in warning for warning in content["warnings"])
        and "caution: degenerate" in told
    )


@pytest.mark.long
def test_the_next_command_names_the_record_to_hold_out(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flightid.done("simulate", "trace-delay", "--out", "flight.csv")
    fit = ("--model", "rigid", "--vehicle", "flight_vehicle.toml")
    told = flightid.done("identify", "flight.csv", *fit)
    before = told[told.index("warning: ") : told.index("  parameter ")].splitlines()
    assert len(before) == 3 and before[1].endswith("; next:"), "two lines and the command"
    assert 'on "do not use these sigmas": a second record (--validate) would' in " ".join(
        told.split()
    )
    both = flightid.done("identify", "flight.csv", "flight_validate.csv", *fit)
    assert "a second record" not in " ".join(both.split())
    command = f"flightid diagnose flight.csv {' '.join(fit)} --validate flight_validate.csv"
    assert command in both
    assert "q (pitch): not white over 25 lags" in " ".join(both.split())
