"""`flightid identify`: the same numbers from every format and unit, and a study folder that says
what was found.
"""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from scipy.io import savemat

from scenarios.files.records import read_record
from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.identification.identify import identify
from scenarios.identification.methods import METHODS
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.estimating import fly_scenario
from sim.record import Hold
from tests.integration.command_line import CommandLine, contents

TRUE = {
    "CL_alpha": 2.922,
    "CL_q": -14.7,
    "CL_de": 0.435,
    "Cm_alpha": -1.66,
    "Cm_q": -34.75,
    "Cm_de": -2.578,
}
ROOT = Path(__file__).parents[3]


def identified(
    flightid: CommandLine, record: Path, vehicle: Path, out: Path, *options: object
) -> dict[str, Any]:
    """The comparison that ``identify`` writes for a rigid record."""
    flightid.done(
        "identify",
        record,
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--no-figures",
        "--out",
        out,
        *options,
    )
    return json.loads((out / "comparison.json").read_text())


@pytest.mark.long
def test_a_filter_draws_its_histories_and_innovations(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    options = (
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--method",
        "ekf",
        "--to",
        2.5,
        "--out",
        tmp_path / "out",
    )
    flightid.done("identify", rigid_folder / "record.csv", *options)
    assert {"parameters.png", "innovations.png", "fit.png"} <= set(contents(tmp_path / "out"))


def found(comparison: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (row["estimate"], row["std"]) for name, row in comparison["parameters"].items()}


def table(folder: Path) -> pandas.DataFrame:
    header, *rows = csv.reader((folder / "record.csv").read_text().splitlines())
    return pandas.DataFrame([[float(cell) for cell in row] for row in rows], columns=header)


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_derivatives(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path, method: str
) -> None:
    content = identified(
        flightid, rigid_folder / "record.csv", vehicle, tmp_path / "out", "--method", method
    )
    assert (content["schema"], content["scenario"], content["method"], content["outcome"]) == (
        "flightid/comparison/1",
        "identify",
        method,
        "converged",
    )
    turbulence = (
        {"gust-turbulence.sigma", "gust-turbulence.length"} if method == "filter-error" else set()
    )
    assert set(content["parameters"]) == {*TRUE, *turbulence}
    assert set(content.get("biases", {})) == (
        {"bias_alpha", "bias_q"} if method in ("ekf", "ukf") else set()
    )
    for name in TRUE:
        value, std = found(content)[name]
        assert 0 < std < 0.15 * abs(TRUE[name])
        assert abs(value - TRUE[name]) < 3.5 * std
    assert not any("true" in row or "published" in row for row in content["parameters"].values())


@pytest.mark.long
def test_what_identify_writes(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    printed = flightid.done(
        "identify",
        rigid_folder / "record.csv",
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--out",
        out,
    )
    content = json.loads((out / "comparison.json").read_text(), parse_constant=pytest.fail)
    assert {*content["files"], "study.txt"} == set(contents(out))
    assert not (out / "truth.json").exists()
    assert {"record.csv", "record.json", "fit.png"} <= set(content["files"])
    assert (out / "record.csv").read_bytes() == (rigid_folder / "record.csv").read_bytes()
    assert (
        content["inputs"]["records"] == ["record.csv"] and len(content["inputs"]["sha256"][0]) == 64
    )
    assert content["fixed"]["mass"] == {"value": pytest.approx(130642.3136, rel=1e-7), "unit": "kg"}
    assert content["derived"]["natural_frequency"]["estimate"] == pytest.approx(1.967, abs=0.005)
    assert content["noise_std"]["alpha"] == pytest.approx(math.sqrt(0.016) * math.pi / 180, rel=0.1)
    for text in (
        "801 samples, 0 to 8 s",
        "Cm_alpha",
        "start",
        "natural frequency",
        f"written to {out}",
    ):
        assert text in printed


@pytest.mark.long
def test_every_format_gives_the_same_numbers(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    frame = table(rigid_folder)
    frame.to_parquet(tmp_path / "flight.parquet")
    savemat(tmp_path / "flight.mat", {name: frame[name].to_numpy() for name in frame})
    savemat(tmp_path / "struct.mat", {"data": {name: frame[name].to_numpy() for name in frame}})
    frame.to_csv(tmp_path / "flight.csv.gz", index=False)
    first = identified(flightid, rigid_folder / "record.csv", vehicle, tmp_path / "csv")
    for name in ("flight.parquet", "flight.mat", "struct.mat", "flight.csv.gz"):
        again = identified(flightid, tmp_path / name, vehicle, tmp_path / f"out-{name}")
        assert found(again) == found(first), name


@pytest.mark.long
def test_degrees_and_radians_give_the_same_numbers(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    frame = table(rigid_folder)
    angles = frame.assign(**{name: np.degrees(frame[name]) for name in ("elevator", "alpha", "q")})
    angles.rename(
        columns={"elevator": "elevator_deg", "alpha": "alpha [deg]", "q": "q_deg_s"}
    ).to_csv(tmp_path / "named.csv", index=False)
    odd = angles.rename(
        columns={"time": "t (ms)", "elevator": "DE", "alpha": "AoA1", "q": "Pitch Rate"}
    ).assign(**{"t (ms)": 1000.0 * frame["time"]})
    odd.to_csv(tmp_path / "odd.csv", index=False)
    (tmp_path / "map.toml").write_text(
        'time = {column = "t (ms)", unit = "ms"}\nelevator = {column = "DE", unit = "deg"}\n'
        'alpha = {column = "AoA1", unit = "deg"}\nq = {column = "Pitch Rate", unit = "deg/s"}\n'
    )
    first = found(identified(flightid, rigid_folder / "record.csv", vehicle, tmp_path / "radians"))
    for again in (
        identified(flightid, tmp_path / "named.csv", vehicle, tmp_path / "degrees"),
        identified(
            flightid,
            tmp_path / "odd.csv",
            vehicle,
            tmp_path / "mapped",
            "--channels",
            tmp_path / "map.toml",
        ),
    ):
        for name, (value, std) in found(again).items():
            assert abs(value - first[name][0]) < 1e-6 * std and std == pytest.approx(
                first[name][1], rel=1e-6
            )


@pytest.mark.long
def test_a_fresh_process_finds_what_this_one_found_in_memory(vehicle: Path, tmp_path: Path) -> None:
    record, _ = fly_scenario(load_scenario("rigid"), seed=4)
    write_record(tmp_path, record)
    here = identify(record, read_vehicle(vehicle, "rigid"), "output-error").estimate
    command = [
        sys.executable,
        "-m",
        "scenarios",
        "identify",
        "record.csv",
        "--model",
        "rigid",
        "--vehicle",
        str(vehicle),
        "--out",
        "out",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(
        [*command, "--no-figures"],
        check=True,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        timeout=60,
    )
    there = found(json.loads((tmp_path / "out" / "comparison.json").read_text()))
    assert there == {name: (here.value(name), here.sigma(name)) for name in here.names}


def test_a_window_reads_only_its_rows(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    broken = table(rigid_folder).astype({"alpha": object})
    broken.loc[700, "alpha"] = "saturated"
    broken.to_csv(tmp_path / "broken.csv", index=False)
    assert "row 702, column 'alpha'" in flightid.refused(
        "identify", tmp_path / "broken.csv", "--model", "rigid", "--vehicle", vehicle
    )
    content = identified(
        flightid, tmp_path / "broken.csv", vehicle, tmp_path / "out", "--from", 0.5, "--to", 6.5
    )
    kept = read_record(tmp_path / "out" / "record.csv", ["elevator"], ["alpha", "q"])
    assert (kept.time[0], kept.time[-1], len(kept)) == (0.5, 6.5, 601)
    assert all(abs(value - TRUE[name]) < 3.5 * std for name, (value, std) in found(content).items())


@pytest.mark.long
def test_gaps_uneven_sampling_and_an_absent_output(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    frame = table(rigid_folder)
    frame.loc[100:160, "alpha"] = np.nan
    frame.loc[::7, "q"] = np.nan
    # a held input is known at every change, or it is another input
    moves = frame["elevator"].diff() != 0.0
    thinned = frame[moves | (frame.index % 11 > 1)]
    assert len(thinned) < 680
    thinned.to_csv(tmp_path / "gaps.csv", index=False)
    whole = found(identified(flightid, rigid_folder / "record.csv", vehicle, tmp_path / "whole"))
    gaps = found(identified(flightid, tmp_path / "gaps.csv", vehicle, tmp_path / "gaps"))
    for name, (value, std) in gaps.items():
        assert abs(value - TRUE[name]) < 3.5 * std and std > whole[name][1]
    thinned[["time", "elevator", "q"]].to_csv(tmp_path / "q.csv", index=False)
    alone = identified(flightid, tmp_path / "q.csv", vehicle, tmp_path / "q")
    assert list(alone["noise_std"]) == ["q"]
    assert all(row["std"] > 0 for row in alone["parameters"].values())


def test_inputs_joined_by_lines_are_read_from_the_sidecar(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    record = read_record(rigid_folder / "record.csv", ["elevator"], ["alpha", "q"])
    write_record(tmp_path, record, "held")
    write_record(
        tmp_path,
        read_record(rigid_folder / "record.csv", ["elevator"], ["alpha", "q"], hold=Hold.LINEAR),
        "linear",
    )
    held, linear = (
        found(identified(flightid, tmp_path / f"{name}.csv", vehicle, tmp_path / name))
        for name in ("held", "linear")
    )
    assert held["Cm_de"] != linear["Cm_de"]
    assert json.loads((tmp_path / "linear" / "record.json").read_text())["hold"] == "linear"


@pytest.mark.long
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(method, marks=pytest.mark.slow if method == "filter-error" else ())
        for method in METHODS
    ],
)
def test_the_zero_of_a_sensor_does_not_matter(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path, method: str
) -> None:
    """Total angles as well as perturbations: five degrees of trim are a bias, and no start of the
    state.
    """
    frame = table(rigid_folder)[::5]
    frame.to_csv(tmp_path / "zero.csv", index=False)
    frame.assign(alpha=frame["alpha"] + np.radians(5.0)).to_csv(tmp_path / "trim.csv", index=False)
    zero, trim = (
        identified(flightid, tmp_path / f"{name}.csv", vehicle, tmp_path / name, "--method", method)
        for name in ("zero", "trim")
    )
    for name in TRUE:
        value, std = found(trim)[name]
        assert abs(value - found(zero)[name][0]) < 0.02 * std
        assert abs(value - TRUE[name]) < 4.0 * std


def test_a_study_of_an_identified_record_is_identified_alike(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    once = identified(
        flightid, rigid_folder / "record.csv", vehicle, tmp_path / "out", "--from", 1.0
    )
    again = identified(flightid, tmp_path / "out" / "record.csv", vehicle, tmp_path / "out")
    assert found(again) == found(once)


def test_the_record_itself_is_never_replaced(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    mine = tmp_path / "record.csv"
    mine.write_bytes((rigid_folder / "record.csv").read_bytes())
    before = contents(tmp_path)
    message = flightid.refused(
        "identify",
        mine,
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--from",
        1,
        "--no-figures",
        "--out",
        tmp_path,
    )
    assert str(mine) in message and "--out" in message
    assert contents(tmp_path) == before


@pytest.mark.long
def test_records_that_say_too_little_end_in_an_outcome(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    frame = table(rigid_folder)
    step = int(np.flatnonzero(frame["elevator"].diff())[1])
    frame[step - 1 : step + 1].to_csv(tmp_path / "two.csv", index=False)
    for method in ("output-error", "equation-error"):
        content = identified(
            flightid, tmp_path / "two.csv", vehicle, tmp_path / f"two-{method}", "--method", method
        )
        assert content["outcome"] == "not-identifiable"
        assert all(row["std"] > 0 for row in content["parameters"].values())
    told = flightid.done("identify", tmp_path / "two.csv", "--model", "rigid", "--vehicle", vehicle)
    rows = [
        line
        for line in told.splitlines()
        if "not determined" in line and not line.startswith(("outcome", "result"))
    ]
    assert len(rows) == 2, (
        "one change of the elevator between two samples does not show what it does; no sigma of "
        "1e30 is printed"
    )


def test_records_in_which_nothing_moves_are_refused(
    flightid: CommandLine, rigid_folder: Path, vehicle: Path, tmp_path: Path
) -> None:
    frame, rng = table(rigid_folder)[:200], np.random.default_rng(0)
    frame.assign(elevator=0.01).to_csv(tmp_path / "still.csv", index=False)
    noise = {name: 0.001 * rng.standard_normal(len(frame)) for name in ("elevator", "alpha", "q")}
    frame.assign(**noise).to_csv(tmp_path / "noise.csv", index=False)
    call = ("--model", "rigid", "--vehicle", vehicle)
    assert "still.csv: the elevator never moves: nothing shows what it does" in flightid.refused(
        "identify", tmp_path / "still.csv", *call
    )
    assert "noise.csv: neither the elevator nor any output moves above" in flightid.refused(
        "identify", tmp_path / "noise.csv", *call
    )
