"""`flightid compare` and `flightid run --compare`: studies side by side, from their folders
alone.
"""

from __future__ import annotations

import csv
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.diagnosis.text import SCHEMA
from scenarios.side_by_side import read_responses
from tests.integration.command_line import CommandLine, contents

NAMES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
CHEAP = ("--set", "flight.rate=20 Hz", "--set", "flight.step=0.01", "--set", "methods=[]")


def strict(path: Path) -> Any:
    return json.loads(path.read_text(), parse_constant=pytest.fail)


def study(folder: Path, parameters: dict[str, Any], **further: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / "comparison.json").write_text(
        json.dumps(
            {
                "schema": "flightid/comparison/1",
                "parameters": parameters,
                "outcome": "converged",
                **further,
            }
        )
    )
    return folder


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rigid aircraft and AC1 seen by a rigid model, compared by ``run``."""
    folder = tmp_path_factory.mktemp("compare") / "out"
    with pytest.raises(SystemExit) as ended:
        from scenarios.cli import main

        main(
            [
                "run",
                "rigid",
                "flexible-ac1-equivalent",
                *CHEAP,
                "--compare",
                "--no-figures",
                "--out",
                str(folder),
            ]
        )
    assert ended.value.code == 0
    return folder


@pytest.mark.long
def test_run_and_compare_leaves_the_studies_and_their_comparison(flown: Path) -> None:
    written = {"compared.json", "compared.csv", "report.html", "report.json", "study.txt"}
    assert {entry.name for entry in flown.iterdir()} == {
        "rigid",
        "flexible-ac1-equivalent",
    } | written
    content = strict(flown / "compared.json")
    assert [each["label"] for each in content["studies"]] == ["rigid", "flexible-ac1-equivalent"]
    assert set(content["parameters"]) == set(NAMES) and set(content["derived"]) == {
        "damping_ratio",
        "natural_frequency",
    }
    for label in ("rigid", "flexible-ac1-equivalent"):
        own = strict(flown / label / "comparison.json")["parameters"]
        for name in NAMES:
            shown = dict(content["parameters"][name]["studies"][label])
            printed = shown.pop("published")
            assert {key: shown[key] for key in shown} == pytest.approx(
                {key: own[name][key] for key in shown}, rel=1e-12
            )
            assert {key: printed[key] for key in ("value", "std")} == own[name]["published"]
            reference = own[name].get("condensed", own[name]["true"])
            assert printed["error_sigmas"] == pytest.approx(
                (printed["value"] - reference) / printed["std"]
            )


def test_the_table_has_a_row_for_each_parameter_and_study_in_the_order_of_the_equations(
    flown: Path,
) -> None:
    rows = list(csv.DictReader((flown / "compared.csv").read_text().splitlines()))
    assert [row["parameter"] for row in rows[:12:2]] == list(NAMES)
    assert [row["study"] for row in rows[:2]] == ["rigid", "flexible-ac1-equivalent"]
    content = strict(flown / "compared.json")["parameters"]
    assert (
        float(rows[1]["condensed"])
        == content["CL_alpha"]["studies"]["flexible-ac1-equivalent"]["condensed"]
        and rows[0]["condensed"] == ""
    )


@pytest.mark.long
def test_compare_again_is_the_same_and_touches_no_study(
    flown: Path, tmp_path: Path, flightid: CommandLine
) -> None:
    before = contents(flown)
    printed = flightid.done(
        "compare",
        flown / "rigid",
        flown / "flexible-ac1-equivalent" / "comparison.json",
        "--out",
        tmp_path / "again",
    )
    assert contents(flown) == before
    again = contents(tmp_path / "again")
    assert {"compared_estimates.png", "compared_errors.png", "compared_responses.png"} <= set(again)
    assert again["compared.csv"] == before["compared.csv"]
    table = printed[printed.index("estimate +- sigma") :]
    assert (
        table.index("CL_alpha") < table.index("Cm_alpha")
        and "condensed" in table
        and "published +- sigma" in table
    )


def test_responses_are_what_was_measured_and_what_the_innovations_say(flown: Path) -> None:
    found = read_responses(flown / "rigid")
    assert found is not None
    history = list(csv.DictReader((flown / "rigid" / "history.csv").read_text().splitlines()))
    record = list(csv.DictReader((flown / "rigid" / "record.csv").read_text().splitlines()))
    for name in ("alpha", "q"):
        innovation = np.array([float(row[f"innovation_{name}"]) for row in history])
        assert found.measured[name] == pytest.approx(
            np.array([float(row[name]) for row in record]), rel=1e-8
        )
        assert found.measured[name] - found.predicted[name] == pytest.approx(innovation, abs=1e-8)
        assert np.std(found.measured[name] - found.true[name]) == pytest.approx(0.0022, rel=0.3)
    assert found.units["q"] == "rad/s" and set(found.inputs) == {"elevator"}


def test_methods_and_diagnoses_are_columns_too(tmp_path: Path, flightid: CommandLine) -> None:
    row = {"estimate": 2.0, "std": 0.1, "unit": "1"}
    one = study(
        tmp_path / "a" / "s",
        {"beta": row, "k": row},
        methods={"other": {"parameters": {"beta": {**row, "estimate": 3.0}}}},
    )
    two = study(
        tmp_path / "b" / "s",
        {"beta": {**row, "true": 1.5}, "gain10": row, "gain9": row, "k": {**row, "unit": "s"}},
    )
    third = tmp_path / "d"
    third.mkdir()
    entry = {"value": 4.0, "std": 0.1, "unit": "1"}
    diagnosis = {
        "schema": SCHEMA,
        "verdict": "traced",
        "derived": {"damping_ratio": {**row, "value": 2.0}},
        "derived_before": {"damping_ratio": {**row, "estimate": 5.0, "value": 5.0}},
        "parameters": {"before": {"beta": {**entry, "value": 9.0}}, "after": {"beta": entry}},
    }
    (third / "diagnosis.json").write_text(json.dumps(diagnosis))
    printed = flightid.done(
        "compare",
        one,
        two,
        third,
        f"{third}:before",
        f"{one}:other",
        "--no-figures",
        "--out",
        tmp_path / "out",
    )
    content = strict(tmp_path / "out" / "compared.json")
    found = {
        label: each["estimate"] for label, each in content["parameters"]["beta"]["studies"].items()
    }
    assert found == {
        "a/s": 2.0,
        "b/s": 2.0,
        f"{tmp_path.name}/d": 4.0,
        f"{tmp_path.name}/d:before": 9.0,
        "a/s:other": 3.0,
    }
    damping = content["derived"]["damping_ratio"]["studies"]
    assert [each["estimate"] for each in damping.values()] == [2.0, 5.0]
    assert content["other_unit"] == ["k"] and content["not_shared"] == {"b/s": ["gain9", "gain10"]}
    assert content["parameters"]["beta"]["studies"]["b/s"]["error_sigmas"] == pytest.approx(5.0)
    assert "in different units, therefore not compared: k" in printed
    both = flightid.done("compare", one, "--methods")
    assert "s:other" in both and "3.00 +- 0.10" in both and "error" not in both, (
        "no truth, no table of errors"
    )


def test_what_cannot_be_compared_is_refused(tmp_path: Path, flightid: CommandLine) -> None:
    row = {"estimate": 2.0, "std": 0.1, "unit": "1"}
    one, other = study(tmp_path / "one", {"beta": row}), study(tmp_path / "other", {"gamma": row})
    strange = study(tmp_path / "strange", {}, schema="flightid/other/1")
    (tmp_path / "empty").mkdir()
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "comparison.json").write_text("{")
    told = {
        (one, other): "share no parameter",
        (one, tmp_path / "empty"): "there is no study in this folder",
        (one, tmp_path / "nowhere"): "there is no such folder",
        (one, strange): "it is no flightid/comparison/1",
        (one, tmp_path / "torn"): "not JSON",
        (one, one): "it is named twice",
        (one, f"{one}:nothing"): "no method 'nothing'",
        (one,): "a single study cannot be compared",
    }
    for arguments, what in told.items():
        assert what in flightid.refused("compare", *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert "name at least two" in flightid.refused("run", "rigid", "--compare")


def test_without_a_folder_the_studies_are_compared_and_gone(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    printed = flightid.done("run", "rigid", "rigid-process-noise-b", *CHEAP, "--compare")
    assert "written to" not in printed and printed.count("estimate +- sigma") == 1
    assert list(tmp_path.iterdir()) == []


def test_studies_of_different_vehicles_or_models_are_said_to_be(
    flightid: CommandLine, tmp_path: Path
) -> None:
    value = {"Cm_q": {"estimate": -20.0, "std": 0.1, "unit": "1/rad"}}
    one = study(tmp_path / "one", value, vehicle="kestrel", model="rigid")
    two = study(tmp_path / "two", value, vehicle="wing", model="rigid")
    three = study(tmp_path / "three", value, vehicle="kestrel", model="aircraft")
    told = " ".join(flightid.done("compare", one, two, "--out", tmp_path / "out").split())
    assert "note: studies of different vehicles (one of kestrel, two of wing)" in told
    assert "different models" not in told
    told = " ".join(flightid.done("compare", one, three).split())
    assert "note: studies of different models (one of rigid, three of aircraft)" in told
    assert "Studies of different vehicles" in (tmp_path / "out" / "report.html").read_text()
