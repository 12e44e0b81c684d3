"""`flightid list`, `run`, `simulate`, `campaign`, `effects`, `vehicles`: what they print and
write.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import pytest

from scenarios.files.records import read_record
from scenarios.files.vehicles import read_any_vehicle
from scenarios.report.figure_formats import caption_of
from scenarios.report.quantities import number_text
from scenarios.studies.catalogue import load_scenario, scenario_names
from sim.effects.library import effect_names
from sim.vehicles.library import vehicle_names
from tests.integration.command_line import CommandLine, contents

DERIVATIVES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")


def refuse_constant(text: str) -> None:
    raise AssertionError(f"{text} is not strict JSON")


def strict(path: Path) -> dict[str, Any]:
    """A JSON file, refused if it holds NaN, infinity or null."""

    def no_null(value: Any) -> None:
        assert value is not None
        for inner in (
            value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        ):
            no_null(inner)

    content = json.loads(path.read_text(), parse_constant=refuse_constant)
    no_null(content)
    assert isinstance(content, dict)
    return content


def small(path: Path, **changes: str) -> Path:
    """A short scenario of the user's own: 2 s at 50 Hz."""
    text = "".join(f"{key} = {value}\n" for key, value in changes.items())
    path.write_text(
        text
        + """
schema = "flightid/scenario/1"
title = "a short doublet"
distance = "same equations, finer step"
[flight]
vehicle = "bomber_rigid"
duration = "2 s"
rate = "50 Hz"
noise_variance = {alpha = "0.016 deg^2", q = "0.016 (deg/s)^2"}
[[flight.maneuvers]]
input = "elevator"
kind = "doublet"
amplitude = "6 deg"
unit = "0.5 s"
[estimate]
model = "rigid"
outputs = ["alpha", "q"]
[estimate.start]
CL_alpha = {value = 3.4, std = 1.0}
CL_q = {value = -11.0, std = 6.0}
CL_de = {value = 0.35, std = 0.2}
Cm_alpha = {value = -1.3, std = 0.6}
Cm_q = {value = -28.0, std = 12.0}
Cm_de = {value = -2.1, std = 0.8}
[estimate.initial]
alpha = {value = 0.0, std = "0.5 deg"}
q = {value = 0.0, std = "0.5 deg/s"}
"""
    )
    return path


def test_list_names_every_scenario_once(flightid: CommandLine) -> None:
    lines = flightid.done("list").splitlines()
    assert [line.split()[0] for line in lines] == list(scenario_names())
    assert all(len(line.split(maxsplit=1)[1]) > 10 for line in lines)


def test_a_listed_scenario_is_a_file_that_runs(flightid: CommandLine, tmp_path: Path) -> None:
    copy = tmp_path / "mine.toml"
    copy.write_text(flightid.done("list", "rigid"))
    mine, theirs = load_scenario(str(copy)), load_scenario("rigid")
    assert mine.name == "mine"
    assert (mine.flight, mine.estimations) == (theirs.flight, theirs.estimations)


@pytest.mark.long
def test_comparison_of_the_rigid_aircraft(rigid_folder: Path) -> None:
    content = strict(rigid_folder / "comparison.json")
    assert content["schema"] == "flightid/comparison/1"
    assert (content["scenario"], content["seed"], content["outcome"]) == ("rigid", 1, "converged")
    assert tuple(content["parameters"]) == tuple(sorted(DERIVATIVES))
    for row in content["parameters"].values():
        assert row["std"] > 0 and row["unit"] == "1/rad"
        assert abs(row["estimate"] - row["true"]) < 3 * row["std"]
        assert row["published"]["std"] > 0
    assert content["parameters"]["CL_alpha"]["true"] == 2.922
    assert content["parameters"]["CL_alpha"]["published"] == {"value": 2.9096, "std": 0.00764}
    assert set(content["fixed"]) >= {
        "mass",
        "wing_area",
        "chord",
        "pitch_inertia",
        "airspeed",
        "air_density",
    }
    assert not set(content["fixed"]) & set(content["parameters"])
    for name, unit in (("natural_frequency", "rad/s"), ("damping_ratio", "1")):
        assert content["derived"][name]["unit"] == unit and content["derived"][name]["std"] > 0
    assert {test["channel"] for test in content["residual_tests"]} >= {"alpha", "q"}
    assert {"numpy", "scipy", "filterpy"} <= set(content["versions"])


def test_the_study_folder_holds_what_the_comparison_lists(rigid_folder: Path) -> None:
    listed = strict(rigid_folder / "comparison.json")["files"]
    assert sorted(entry.name for entry in rigid_folder.iterdir()) == sorted(listed)
    assert {
        "record.csv",
        "record.json",
        "truth.json",
        "comparison.json",
        "history.csv",
        "fit.png",
        "innovations.png",
        "parameters.png",
    } <= set(listed)
    assert strict(rigid_folder / "record.json")["hold"] == "previous"
    assert strict(rigid_folder / "truth.json")["parameters"]["Cm_de"]["value"] == -2.578
    assert [entry.name for entry in rigid_folder.parent.iterdir()] == ["rigid"]


def test_its_page_shows_every_figure_and_estimate_and_is_made_again_to_the_byte(
    flightid: CommandLine, rigid_folder: Path
) -> None:
    page = (rigid_folder / "report.html").read_bytes()
    content = strict(rigid_folder / "report.json")
    drawn = [
        block for section in content["sections"] for block in section["blocks"] if "figure" in block
    ]
    assert {block["figure"] for block in drawn} == {
        f"figure-{path.stem}" for path in rigid_folder.glob("*.png") if path.stem != "record"
    }, "the record stands above the fit"
    assert drawn[0]["figure"] == "figure-fit"
    assert all(
        caption_of(block["figure"].removeprefix("figure-")) == block["caption"] for block in drawn
    )
    (found,) = [
        block
        for section in content["sections"]
        for block in section["blocks"]
        if block.get("table", "").startswith("Extended Kalman")
    ]
    at = [column["heading"] for column in found["columns"]].index("estimate ± σ")
    shown = {row[0]: (row[at]["value"], row[at]["sigma"]) for row in found["rows"]}
    assert shown == {
        name: (row["estimate"], row["std"])
        for name, row in strict(rigid_folder / "comparison.json")["parameters"].items()
    }
    assert (
        "written to" in flightid.done("report", rigid_folder)
        and (rigid_folder / "report.html").read_bytes() == page
    )


def test_report_of_a_folder_without_a_page_is_one_line(
    flightid: CommandLine, rigid_folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "comparison.json").write_bytes((rigid_folder / "comparison.json").read_bytes())
    assert "flightid run rigid --seed 1 --out" in flightid.refused("report", tmp_path)


def test_history_ends_at_the_estimate(rigid_folder: Path) -> None:
    rows = list(csv.DictReader((rigid_folder / "history.csv").read_text().splitlines()))
    parameters = strict(rigid_folder / "comparison.json")["parameters"]
    assert len(rows) == 801
    for name, row in parameters.items():
        assert float(rows[-1][name]) == pytest.approx(row["estimate"], rel=1e-8)
        assert float(rows[-1][f"std_{name}"]) == pytest.approx(row["std"], rel=1e-8)
    assert all(math.isfinite(float(cell)) for row in rows for cell in row.values())


def test_the_same_seed_writes_the_same_bytes(
    flightid: CommandLine, rigid_folder: Path, tmp_path: Path
) -> None:
    flightid.done("run", "rigid", "--no-figures", "--out", tmp_path / "a")
    for name in ("record.csv", "record.json", "truth.json", "history.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (rigid_folder / name).read_bytes()
    again, before = (
        strict(tmp_path / "a" / "comparison.json"),
        strict(rigid_folder / "comparison.json"),
    )
    for content in (again, before):
        content.pop("files")
        content.pop("versions")
    assert again == before


def test_seed_and_set_change_what_they_name(flightid: CommandLine, tmp_path: Path) -> None:
    scenario = small(tmp_path / "short.toml")
    flightid.done("run", scenario, "--no-figures", "--out", tmp_path / "a")
    flightid.done("run", scenario, "--no-figures", "--seed", 7, "--out", tmp_path / "b")
    flightid.done(
        "run",
        scenario,
        "--no-figures",
        "--set",
        "flight.rate=25 Hz",
        "--set",
        "estimate.start.CL_q.value=-12",
        "--out",
        tmp_path / "c",
    )
    a, b, c = (
        read_record(tmp_path / each / "record.csv", ["elevator"], ["alpha", "q"]) for each in "abc"
    )
    assert (len(a), len(b), len(c)) == (101, 101, 51)
    assert (a["alpha"].values != b["alpha"].values).all()
    assert [strict(tmp_path / each / "comparison.json")["seed"] for each in "abc"] == [1, 7, 1]


def test_run_prints_true_estimate_and_published(flightid: CommandLine, rigid_folder: Path) -> None:
    printed = flightid.done("run", "rigid")
    assert len(printed.splitlines()) <= 20 and "published" not in printed
    whole = (rigid_folder / "study.txt").read_text(encoding="utf-8")
    for name, row in strict(rigid_folder / "comparison.json")["parameters"].items():
        line = next(line for line in whole.splitlines() if f" {name} " in line)
        brief = next(line for line in printed.splitlines() if line.startswith(f"  {name} "))
        assert number_text(row["estimate"], row["std"]) in brief
        for text in (
            f"{row['true']:.5g}",
            number_text(row["estimate"], row["std"]),
            f"{row['error_sigmas']:+.2f}",
            f"{row['published']['value']:.5g}",
        ):
            assert text in line


def test_brackets_in_texts_are_printed(flightid: CommandLine, tmp_path: Path) -> None:
    """Scenarios mark with [own] what this project chose; a terminal library must not take it for
    its own mark-up.
    """
    scenario = small(tmp_path / "short.toml")
    printed = flightid.done(
        "run",
        scenario,
        "--set",
        "estimate.explanation=the unit is [own]",
        "--set",
        "title=[1] of [bold]2[/bold]",
        "--no-figures",
        "--out",
        tmp_path / "out",
    )
    whole = (tmp_path / "out" / "study.txt").read_text(encoding="utf-8")
    assert "the unit is [own]" in whole and "[1] of [bold]2[/bold]" in printed


def test_several_scenarios_get_a_folder_each(flightid: CommandLine, tmp_path: Path) -> None:
    first, second = small(tmp_path / "first.toml"), small(tmp_path / "second.toml", seed="2")
    flightid.done("run", first, second, "--no-figures", "--out", tmp_path / "out")
    assert sorted(entry.name for entry in (tmp_path / "out").iterdir()) == ["first", "second"]
    assert strict(tmp_path / "out" / "first" / "comparison.json")["scenario"] == "first"
    assert strict(tmp_path / "out" / "second" / "comparison.json")["seed"] == 2


@pytest.mark.long
def test_a_rerun_replaces_ours_and_leaves_others(flightid: CommandLine, tmp_path: Path) -> None:
    scenario, out = small(tmp_path / "short.toml"), tmp_path / "out"
    flightid.done("run", scenario, "--out", out)
    (out / "notes.md").write_text("mine")
    first = contents(out)
    flightid.done("run", scenario, "--no-figures", "--seed", 2, "--out", out)
    second = contents(out)
    assert second["notes.md"] == b"mine"
    assert second["record.csv"] != first["record.csv"]
    assert any(name.endswith(".png") for name in first) and not any(
        name.endswith(".png") for name in second
    )
    assert set(strict(out / "comparison.json")["files"]) | {"notes.md"} == set(second)


def test_a_failing_run_leaves_nothing_behind(flightid: CommandLine, tmp_path: Path) -> None:
    scenario, out = small(tmp_path / "short.toml"), tmp_path / "out"
    wrong = ("run", scenario, "--no-figures", "--set", 'display={CL_q = "m"}', "--out", out)
    assert "short.toml, key display.CL_q" in flightid.refused(*wrong)
    assert not out.exists()
    flightid.done("run", scenario, "--no-figures", "--out", out)
    before = contents(tmp_path)
    flightid.refused(*wrong)
    assert contents(tmp_path) == before


def test_a_failure_while_writing_leaves_the_older_study_whole(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, out = small(tmp_path / "short.toml"), tmp_path / "out"
    flightid.done("run", scenario, "--no-figures", "--out", out)
    before = contents(tmp_path)

    def broken(*_: object) -> None:
        raise RuntimeError("in the middle")

    monkeypatch.setattr("scenarios.studies.folder.history_csv", broken)
    call = flightid("run", scenario, "--no-figures", "--seed", 2, "--out", out)
    assert (
        call.code == 1
        and call.err.count("\n") == 1
        and "internal error: RuntimeError: in the middle" in call.err
    )
    assert contents(tmp_path) == before
    with pytest.raises(RuntimeError):
        from scenarios.cli import main

        main(["--debug", "run", str(scenario), "--no-figures", "--out", str(out)])


def test_simulate_writes_the_record_alone(
    flightid: CommandLine, rigid_folder: Path, tmp_path: Path
) -> None:
    said = flightid.done("simulate", "rigid", "--out", tmp_path / "new" / "flight.csv")
    assert "--vehicle bomber_rigid" in said
    assert sorted(contents(tmp_path)) == ["new/flight.csv", "new/flight.json"]
    assert (tmp_path / "new" / "flight.csv").read_bytes() == (
        rigid_folder / "record.csv"
    ).read_bytes()


@pytest.mark.long
def test_campaign_counts_what_the_intervals_hold(flightid: CommandLine, tmp_path: Path) -> None:
    printed = flightid.done(
        "campaign",
        small(tmp_path / "short.toml"),
        "--runs",
        20,
        "--seed",
        3,
        "--out",
        tmp_path / "out",
    )
    assert "20 runs from seed 3" in printed and "within 2 sigma" in printed
    content = strict(tmp_path / "out" / "campaign.json")
    assert (content["schema"], content["runs"], content["seed"], content["broken"]) == (
        "flightid/campaign/1",
        20,
        3,
        0,
    )
    rows = list(csv.DictReader((tmp_path / "out" / "estimates.csv").read_text().splitlines()))
    assert len(rows) == 20
    hits = {}
    for name, spread in content["parameters"].items():
        values = [float(row[name]) for row in rows]
        assert spread["bias"] == pytest.approx(sum(values) / 20 - spread["reference"], abs=1e-12)
        hits[name] = sum(
            abs(float(row[name]) - spread["reference"]) <= 2 * float(row[f"std_{name}"])
            for row in rows
        )
        assert spread["within_two_sigma"] == hits[name] / 20
        assert spread["interval"][0] <= spread["within_two_sigma"] <= spread["interval"][1]
    assert content["pooled"]["within_two_sigma"] == pytest.approx(sum(hits.values()) / 120)


@pytest.mark.long
@pytest.mark.parametrize(
    "keys", [("passes=1",), ("passes=4",), ("passes=4", "spread=20"), ("method=output-error",)]
)
def test_a_run_of_a_campaign_is_the_run_of_that_seed(
    flightid: CommandLine, tmp_path: Path, keys: tuple[str, ...]
) -> None:
    scenario = small(tmp_path / "short.toml")
    changes = [text for key in keys for text in ("--set", f"estimate.{key}")]
    flightid.done(
        "campaign", scenario, "--runs", 2, "--seed", 6, *changes, "--out", tmp_path / "many"
    )
    rows = list(csv.DictReader((tmp_path / "many" / "estimates.csv").read_text().splitlines()))
    flightid.done(
        "run",
        scenario,
        "--no-figures",
        "--seed",
        rows[1]["seed"],
        *changes,
        "--out",
        tmp_path / "one",
    )
    for name, row in strict(tmp_path / "one" / "comparison.json")["parameters"].items():
        assert float(rows[1][name]) == pytest.approx(row["estimate"], rel=1e-9)
        assert float(rows[1][f"std_{name}"]) == pytest.approx(row["std"], rel=1e-7)


@pytest.mark.long
def test_effects_and_vehicles_are_shown(flightid: CommandLine) -> None:
    overview = flightid.done("effects")
    assert [line.split()[0] for line in overview.splitlines()] == list(effect_names())
    assert max(len(line) for line in overview.splitlines()) <= 80
    one = flightid.done("effects", "input-delay")
    assert "input path" in one and "delay" in one and "absent when" in one
    gust = flightid.done("effects", "gust-discrete")
    made = flightid.done("effects", "input-delay:rudder")
    assert (
        made.startswith("input-delay:rudder  (input path)")
        and "hard to tell from actuator-lag:rudder" in made
    )
    assert (
        "flat on top" in gust
        and "adds shape1 (m/s), shape2 (m/s), shape3 (m/s)" in gust
        and "inf" not in gust
    )
    catch_all = flightid.done("effects", "guard:vane-behind")
    assert catch_all.startswith("This is a catch-all term") and "arm" in catch_all
    assert [line.split()[0] for line in flightid.done("vehicles").splitlines()] == list(
        vehicle_names()
    )
    assert "288017 lb" in flightid.done("vehicles", "bomber_rigid")
    difference = flightid.done("vehicles", "bomber_ac1", "--diff", "bomber_rigid")
    assert "omega1" in difference and "wing_area" not in difference


@pytest.mark.long
def test_simulate_writes_what_the_loop_is_given(flightid: CommandLine, tmp_path: Path) -> None:
    shorter = (
        "--set",
        "flight.train.duration=3",
        "--set",
        "flight.validate.duration=2",
        "--set",
        "flight.step=0.01",
    )
    printed = flightid.done(
        "simulate", "trace-longitudinal-thrust", *shorter, "--out", tmp_path / "flight.csv"
    )
    assert "flight_validate.csv" in printed and "flight_vehicle.toml" in printed
    assert {"flight.csv", "flight_validate.csv", "flight_vehicle.toml"} <= set(contents(tmp_path))
    assert (
        len(read_record(tmp_path / "flight.csv")),
        len(read_record(tmp_path / "flight_validate.csv")),
    ) == (76, 51)
    assert flightid.done(
        "check", tmp_path / "flight.csv", "--vehicle", tmp_path / "flight_vehicle.toml"
    )


def test_simulate_writes_the_file_of_an_aircraft_beside_its_record(
    flightid: CommandLine, tmp_path: Path
) -> None:
    record = tmp_path / "flight.csv"
    changes = ("--set", "flight.duration=2", "--set", "flight.step=0.04")
    printed = flightid.done("simulate", "aircraft-airliner", "--out", record, *changes)
    vehicle = tmp_path / "flight_vehicle.toml"
    assert f"flightid identify {record} --model aircraft --vehicle {vehicle}" in printed
    assert read_any_vehicle(vehicle).name == "airliner"
    # A file that flightid did not write stays, and no half of the output is left beside it.
    (tmp_path / "other_vehicle.toml").write_text("mine")
    other = tmp_path / "other.csv"
    flightid.refused("simulate", "aircraft-airliner", "--out", other, *changes)
    assert (tmp_path / "other_vehicle.toml").read_text() == "mine" and not other.exists()
