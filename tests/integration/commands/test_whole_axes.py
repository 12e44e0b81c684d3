"""`identify`, `diagnose` and `check` on lateral and longitudinal records: what is printed and
written, and every refusal in one line.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.declaration.model import Noise
from sim.maneuvers import Maneuver, Sum, doublet, three_two_one_one
from sim.record import Record
from sim.truth.flight import fly, sample_times
from tests.integration.command_line import CommandLine, contents
from tests.whole_axes import NOISE, RATE, TRUE, flown, true_model, vehicle_text, write_flown


@pytest.fixture(scope="module")
def records() -> dict[str, Record]:
    return {model: flown(model) for model in TRUE}


@pytest.mark.long
@pytest.mark.parametrize("model", list(TRUE))
def test_what_identify_prints_and_writes(
    flightid: CommandLine, tmp_path: Path, records: dict[str, Record], model: str
) -> None:
    path = write_flown(tmp_path, model, records[model])
    out = tmp_path / "out"
    options = (
        "--model",
        model,
        "--vehicle",
        tmp_path / "vehicle.toml",
        "--out",
        out,
        "--class",
        "I",
        "--state-space",
        tmp_path / "plant.json",
    )
    printed = flightid.done("identify", path, *options)
    content = json.loads((out / "comparison.json").read_text(), parse_constant=pytest.fail)
    assert (content["model"], content["outcome"]) == (model, "converged") and set(
        content["parameters"]
    ) == set(TRUE[model])
    for name, row in content["parameters"].items():
        assert abs(row["estimate"] - TRUE[model][name]) < 3.5 * row["std"]
    assert {"fit.png", "record.png", "correlation.png", "record.csv"} <= set(contents(out))
    assert (
        "levels by MIL-F-8785C, class I, category B (category assumed, as neither an "
        "option (--class, --category) nor the vehicle file gives it): " in " ".join(printed.split())
    )
    levels = content["flying_qualities"]["modes"]
    assert all(level["level"] == 1 and level["determined"] for level in levels.values())
    plant = json.loads((tmp_path / "plant.json").read_text(), parse_constant=pytest.fail)
    roots = [root for root in np.linalg.eigvals(np.array(plant["A"])) if root.imag > 0]
    printed_as = {
        name: entry["estimate"]
        for name, entry in content["derived"].items()
        if name.endswith("frequency")
    }
    assert sorted(printed_as.values()) == pytest.approx(sorted(map(abs, roots)), rel=1e-9), (
        "the modes that are printed are those of the matrices"
    )
    if model == "lateral":
        assert set(levels) == {"Dutch roll", "roll mode", "spiral"}
        assert {name: entry["unit"] for name, entry in content["derived"].items()} == {
            **{
                "dutch_roll_frequency": "rad/s",
                "dutch_roll_damping": "1",
                "roll_time_constant": "s",
                "spiral_time_constant": "s",
            }
        }
        assert "Dutch roll frequency" in printed and "roll time constant" in " ".join(
            printed.split()
        )
    else:
        assert set(levels) == {"short period", "phugoid"}
        assert set(content["derived"]) == {
            "short_period_frequency",
            "short_period_damping",
            "phugoid_frequency",
            "phugoid_damping",
        }
        assert "phugoid frequency" in printed and "residual (1 sigma): airspeed 0.2" in " ".join(
            printed.split()
        )


def late(record: Record, name: str, rows: int) -> Record:
    """The record with one input recorded ``rows`` samples before it acts."""
    inputs = tuple(
        type(c).of(c.name, c.unit, np.concatenate([c.values[rows:], np.full(rows, c.values[-1])]))
        if c.name == name
        else c
        for c in record.inputs
    )
    return Record(record.time, inputs, record.outputs, record.hold, record.name)


def diagnosed(
    flightid: CommandLine, folder: Path, model: str, path: Path
) -> tuple[str, dict[str, Any]]:
    out = folder / "out"
    printed = flightid.done(
        "diagnose", path, "--model", model, "--hold", "previous", "--no-figures", "--out", out
    )
    return printed, json.loads((out / "diagnosis.json").read_text(), parse_constant=pytest.fail)


@pytest.mark.long
@pytest.mark.parametrize("model", list(TRUE))
def test_a_sound_record_is_consistent_and_the_kinematics_are_not_asked(
    flightid: CommandLine, tmp_path: Path, records: dict[str, Record], model: str
) -> None:
    path = write_flown(tmp_path, model, records[model])
    printed, content = diagnosed(flightid, tmp_path, model, path)
    assert (
        content["verdict"] == "consistent"
        and "compatibility" not in content
        and not content["effects"]
    )
    units = {"beta": "rad", "p": "rad/s", "r": "rad/s", "phi": "rad", "ny": "g"}
    longitudinal = {
        "airspeed": "m/s",
        "alpha": "rad",
        "theta": "rad",
        "q": "rad/s",
        "nz": "g",
        "nx": "g",
    }
    assert content["error"]["unit"] == (units if model == "lateral" else longitudinal)
    with (tmp_path / "out" / "validate_prediction.csv").open(newline="") as stream:
        header, *rows = csv.reader(stream)
    assert {f"after_{name}" for name in content["error"]["unit"]} <= set(header)
    assert all(math.isfinite(float(cell)) for row in rows for cell in row)
    shown = {
        "lateral": ("  p      deg/s", "  ny     g"),
        "longitudinal": ("  airspeed  m/s", "  theta     deg"),
    }
    assert all(text in printed for text in shown[model])


@pytest.mark.long
def test_a_sentence_names_the_input_that_is_late(
    flightid: CommandLine, tmp_path: Path, records: dict[str, Record]
) -> None:
    path = write_flown(tmp_path, "lateral", late(records["lateral"], "rudder", 3))
    printed, content = diagnosed(flightid, tmp_path, "lateral", path)
    (effect,) = content["effects"]
    assert effect["name"] == "input-delay:rudder" and effect["parameters"]["delay"][
        "value"
    ] == pytest.approx(0.12, abs=0.005)
    assert effect["sentence"] == "the aircraft responds 0.120 s after the recorded rudder"
    assert "CY_beta" in printed and "the aircraft responds" in content["headline"]


REFUSED = [
    ("lateral", "aileron", "there is no column 'aileron'"),
    ("lateral", "rudder", "there is no column 'rudder'"),
    ("longitudinal", "thrust", "there is no column 'thrust'"),
]


@pytest.mark.parametrize(("model", "absent", "said"), REFUSED)
def test_a_control_must_be_there(
    flightid: CommandLine,
    tmp_path: Path,
    records: dict[str, Record],
    model: str,
    absent: str,
    said: str,
) -> None:
    path = write_flown(tmp_path, model, records[model], {absent: ("other", 1.0)})
    line = flightid.refused(
        "identify", path, "--model", model, "--vehicle", tmp_path / "vehicle.toml"
    )
    assert said in line and f"name the column {absent}" in line


@pytest.mark.long
def test_files_and_methods_that_do_not_fit(
    flightid: CommandLine, tmp_path: Path, records: dict[str, Record]
) -> None:
    lateral, longitudinal = (tmp_path / model for model in TRUE)
    paths = {}
    for folder in (lateral, longitudinal):
        folder.mkdir()
        paths[folder.name] = write_flown(folder, folder.name, records[folder.name])
    wrong = flightid.refused(
        "identify",
        paths["lateral"],
        "--model",
        "lateral",
        "--vehicle",
        longitudinal / "vehicle.toml",
    )
    assert "vehicle.toml: this vehicle file is for the longitudinal model" in wrong
    asked = (
        "identify",
        paths["lateral"],
        "--model",
        "lateral",
        "--vehicle",
        lateral / "vehicle.toml",
    )
    assert "--class: there is no class 'V'; use I, II, III or IV" in flightid.refused(
        *asked, "--class", "V"
    )
    assert "name a file that ends in .json, .mat, .npz" in flightid.refused(
        *asked, "--state-space", lateral / "plant.txt"
    )
    assert "vehicle.toml: this vehicle file is for the lateral model" in flightid.refused(
        "diagnose", paths["lateral"], "--model", "rigid"
    )
    (lateral / "vehicle.toml").write_text(
        (lateral / "vehicle.toml").read_text().split("[derivatives]")[0] + "[derivatives]\n"
    )
    assert "no derivative is given; give where the search starts" in flightid.refused(
        "diagnose", paths["lateral"], "--model", "lateral"
    )


@pytest.mark.long
def test_the_kinematics_are_checked_with_a_longitudinal_file(
    flightid: CommandLine, tmp_path: Path, records: dict[str, Record]
) -> None:
    printed = flightid.done("check", write_flown(tmp_path, "longitudinal", records["longitudinal"]))
    assert "relation of alpha: alpha, q, nz" in printed and "relation of theta: theta, q" in printed


@pytest.mark.long
def test_a_gap_in_time_with_a_poor_start_is_named_and_does_no_harm(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """All signs of the vehicle file are turned, so that the fit begins again from equation error;
    rows of a long rest are missing.
    """
    moves: dict[str, Maneuver] = {
        "aileron": Sum((doublet(0.07, 0.8, 1.0), doublet(0.05, 0.8, 41.0))),
        "rudder": three_two_one_one(0.06, 0.72, 4.0),
    }
    true = true_model("lateral").with_noise(Noise(NOISE["lateral"]))
    record, _ = fly(true, moves, sample_times(RATE, 48.0), np.random.default_rng(3), step=0.01)
    kept = (record.time < 14.0) | (record.time > 40.0)
    columns = {"time": record.time[kept]} | {
        channel.name: channel.values[kept] for channel in record.channels
    }
    path = tmp_path / "gap.csv"
    np.savetxt(
        path,
        np.array([*columns.values()]).T,
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.12g",
    )
    (tmp_path / "vehicle.toml").write_text(vehicle_text("lateral", -0.9), encoding="utf-8")
    printed = " ".join(
        flightid.done(
            "identify", path, "--model", "lateral", "--out", tmp_path / "out", "--no-figures"
        ).split()
    )
    assert "the record has a gap (13." in printed and "is used as 2 records" in printed
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert found["outcome"] == "converged" and "has the other sign" in printed
    for name in ("Cl_p", "Cn_beta", "Cl_beta", "Cn_r"):
        assert abs(found["parameters"][name]["estimate"] - TRUE["lateral"][name]) < 0.1 * abs(
            TRUE["lateral"][name]
        ), name


GAP = Path(__file__).parents[4] / "shared" / "cases" / "lateral-time-gap"


@pytest.mark.long
@pytest.mark.skipif(not GAP.is_dir(), reason="the folder of shared cases is not here")
def test_the_gap_of_a_measured_kind_is_fitted(flightid: CommandLine, tmp_path: Path) -> None:
    call = (
        "identify",
        GAP / "gap.csv",
        "--model",
        "lateral",
        "--vehicle",
        GAP / "vehicle.toml",
        "--out",
        tmp_path / "out",
        "--no-figures",
    )
    printed = " ".join(flightid.done(*call).split())
    assert "the record has a gap (19.96 to 50 s) and is used as 2 records" in printed
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert (
        found["outcome"] == "converged"
        and abs(found["parameters"]["Cl_p"]["estimate"] + 0.51) < 0.01
    )
