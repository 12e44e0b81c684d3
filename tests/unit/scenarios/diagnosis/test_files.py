"""The study folder of a diagnosis: predictions row for row, residuals, evidence, figures, the same
bytes again.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.files import (
    draw_diagnosis,
    pictured,
    write_diagnosis,
    write_evidence,
    write_prediction,
    write_residuals,
)
from scenarios.report.folder import rebuilt
from tests.diagnoses import BALLISTIC, LOES, spread_tracing, tracing_of

FIGURES = {"held_out.png", "residuals.png", "evidence.png", "derivatives.png", "spectra.png"}


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("study") / "out"
    write_diagnosis(tracing_of(Verdict.TRACED, validations=2, count=120), path)
    yield path


@pytest.mark.long
def test_folder_holds_what_it_lists(folder: Path) -> None:
    names = {entry.name for entry in folder.iterdir()}
    assert names == set(json.loads((folder / "diagnosis.json").read_bytes())["files"])
    assert names >= FIGURES | {
        "diagnosis.json",
        "validate_prediction.csv",
        "validate_prediction_2.csv",
        "residuals.csv",
        "evidence.csv",
        "report.html",
        "report.json",
    }
    assert "held_out_2.png" in names


@pytest.mark.parametrize(
    ("vehicle", "channels"),
    [
        (None, ("alpha", "q", "nz")),
        (None, ("alpha", "q")),
        (LOES, ("nz",)),
        (BALLISTIC, ("altitude",)),
    ],
)
@pytest.mark.parametrize("verdict", list(Verdict))
def test_prediction_has_a_row_for_each_row_of_the_record(
    verdict: Verdict, vehicle, channels: tuple[str, ...], tmp_path: Path
) -> None:
    tracing = (
        tracing_of(verdict, channels=channels)
        if vehicle is None
        else tracing_of(verdict, vehicle, channels=channels)
    )
    prediction = tracing.diagnosis.predictions[0]
    write_prediction(tmp_path / "p.csv", prediction)
    rows = rows_of(tmp_path / "p.csv")
    assert list(rows[0]) == [
        "time",
        *(f"before_{name}" for name in channels),
        *(f"after_{name}" for name in channels),
    ]
    # The record lacks samples at its rows 11, 12 and the last: they are predicted all the same.
    assert not prediction.record[channels[0]].valid.all()
    assert [float(row["time"]) for row in rows] == prediction.record.time.tolist()
    for index, name in enumerate(channels):
        assert [float(row[f"before_{name}"]) for row in rows] == prediction.before[index].tolist()
        assert [float(row[f"after_{name}"]) for row in rows] == prediction.after[index].tolist()


def test_prediction_that_ran_away_is_written_in_finite_numbers(tmp_path: Path) -> None:
    prediction = tracing_of(Verdict.TRACED).diagnosis.predictions[0]
    before = prediction.before.copy()
    before[0, 5:8] = np.inf, -np.inf, np.nan
    write_prediction(tmp_path / "p.csv", replace(prediction, before=before))
    rows = rows_of(tmp_path / "p.csv")
    assert all(math.isfinite(float(cell)) for row in rows for cell in row.values())
    assert float(rows[5]["before_alpha"]) > 1e20 and float(rows[6]["before_alpha"]) < -1e20


def test_residuals_leave_missing_samples_empty_and_mark_what_was_set_aside(tmp_path: Path) -> None:
    fitted = tracing_of(Verdict.TRACED).diagnosis.fitted[0]
    write_residuals(tmp_path / "r.csv", fitted)
    rows = rows_of(tmp_path / "r.csv")
    assert len(rows) == len(fitted.record)
    assert (
        rows[10]["before_alpha"] == rows[10]["after_alpha"] == "" and rows[10]["used_alpha"] == "0"
    )
    assert rows[50]["used_alpha"] == "0" and float(rows[50]["after_alpha"]) == fitted.after[0, 50]
    assert rows[51]["used_alpha"] == "1" and float(rows[51]["after_q"]) == fitted.after[1, 51]


def test_residuals_of_a_record_that_lacks_a_channel(tmp_path: Path) -> None:
    fitted = tracing_of(Verdict.TRACED).diagnosis.fitted[0]
    write_residuals(tmp_path / "r.csv", replace(fitted, record=fitted.record.only(["q", "nz"])))
    assert (
        "before_alpha" not in rows_of(tmp_path / "r.csv")[0]
        and "before_nz" in rows_of(tmp_path / "r.csv")[0]
    )


def test_evidence_has_a_row_for_each_candidate(tmp_path: Path) -> None:
    candidates = tracing_of(Verdict.PARTIAL).diagnosis.candidates
    write_evidence(tmp_path / "e.csv", candidates)
    rows = rows_of(tmp_path / "e.csv")
    assert [row["name"] for row in rows] == [c.name for c in candidates]
    assert [float(row["gain"]) for row in rows] == [c.gain for c in candidates]
    assert (
        rows[0]["collinear_with"] == "sensor-delay:alpha vane-offset"
        and rows[1]["within"] == "sensor-lag:alpha"
    )


@pytest.mark.long
def test_same_diagnosis_same_bytes_but_for_the_time_stamp(folder: Path, tmp_path: Path) -> None:
    write_diagnosis(tracing_of(Verdict.TRACED, validations=2, count=120), tmp_path / "again")
    for entry in folder.iterdir():
        other = (tmp_path / "again" / entry.name).read_bytes()
        if entry.suffix == ".json":
            a, b = json.loads(entry.read_bytes()), json.loads(other)
            assert a.pop("created") and b.pop("created")
            assert a == b
        elif entry.name == "report.html":
            first, again = (
                re.sub(rb"<time.*?</time>", b"", page) for page in (entry.read_bytes(), other)
            )
            assert first == again
        else:
            assert entry.read_bytes() == other, entry.name


@pytest.mark.long
def test_page_is_made_again_from_its_folder_to_the_byte(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "report.json").write_bytes((folder / "report.json").read_bytes())
    assert rebuilt(tmp_path).read_bytes() == (folder / "report.html").read_bytes()
    # one more record is predicted
    assert (folder / "report.html").read_bytes().count(b"<svg ") == len(FIGURES) + 1


def test_older_run_is_replaced_and_other_files_are_left(tmp_path: Path) -> None:
    write_diagnosis(tracing_of(Verdict.TRACED, validations=2, count=60), tmp_path, figures=())
    (tmp_path / "notes.txt").write_text("mine")
    write_diagnosis(tracing_of(Verdict.CONSISTENT, count=60), tmp_path, figures=())
    names = {entry.name for entry in tmp_path.iterdir()}
    assert names == {
        "diagnosis.json",
        "validate_prediction.csv",
        "residuals.csv",
        "evidence.csv",
        "report.html",
        "report.json",
        "notes.txt",
    }
    assert json.loads((tmp_path / "diagnosis.json").read_bytes())["verdict"] == "consistent"


def test_replication_is_drawn_where_there_is_some(tmp_path: Path) -> None:
    picture = pictured(spread_tracing())
    (shown,) = picture.replicated
    assert shown.name == "sensor-lag:alpha" and shown.records == (
        "record_1.csv",
        "record_2.csv",
        "record_3.csv",
    )
    assert [each["time_constant"].value for each in shown.by_record] == [0.058, 0.063, 0.060]
    alone = replace(picture, predictions=(), fitted=(), candidates=(), before={})
    (drawn,) = draw_diagnosis(alone, tmp_path, ())
    assert drawn.stem == "replication" and not list(tmp_path.iterdir())
    assert pictured(tracing_of(Verdict.PARTIAL)).replicated == ()
