"""The campaign of every effect by the command line: rows, tables, files, one flight again."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exam.__main__ import main
from exam.every_effect import work
from exam.every_effect.campaign import COLUMNS, cells_of
from exam.every_effect.carriers import Instance, drawn_carrier
from exam.every_effect.flight import Flown
from exam.every_effect.work import EveryEffect, scored_flight_of
from exam.repeated import fly_all
from exam.scores.scored_flight import Outcome, Standing
from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.tasks.study import Execution
from tests.diagnoses import tracing_of


@pytest.mark.long
def test_rows_do_not_depend_on_how_many_there_are_and_are_read_as_they_were_written(
    tmp_path: Path,
) -> None:
    falls = EveryEffectOfFalls(("nothing", "density-scale-height"))
    whole = fly_all(falls, 2, 6, Execution(1, tmp_path / "a"))
    part = fly_all(falls, 1, 6, Execution(1, tmp_path / "b"))
    more = fly_all(falls, 2, 6, Execution(1, tmp_path / "b", resume=True))
    rows = [cells_of(each) for each in whole.found]
    assert [cells_of(each) for each in part.found] == rows[:1] and [
        cells_of(each) for each in more.found
    ] == rows
    assert all({*row} == {*COLUMNS} for row in rows)
    clean, named = whole.found
    assert (clean.effect, clean.hidden, named.effect, named.hidden) == (
        "nothing",
        "",
        "density-scale-height",
        "density-scale-height",
    )
    assert clean.marked.right and clean.marked.outcome is Outcome.NOTHING
    assert (
        named.marked.standing is Standing.RIGHT
        and abs(named.marked.errors["density-scale-height.change"]) < 5.0
    )
    assert named.marked.held_out_before > 1.2 > named.marked.held_out_after > 0.8


class EveryEffectOfFalls(EveryEffect):
    """The same on falling bodies alone, which are diagnosed in tenths of a second."""

    @property
    def kinds(self):
        return {
            name: tuple(each for each in found if each.model == "ballistic")
            for name, found in super().kinds.items()
        }


def claimed(
    name: str, *others: str, verdict: Verdict = Verdict.TRACED, **values: tuple[float, float]
) -> Any:
    tracing = tracing_of(verdict)
    found = {local: Quantity(value, std, "1") for local, (value, std) in values.items()}
    claim = Claim(name, found, others, probability={name: 0.7, **dict.fromkeys(others, 0.2)})
    object.__setattr__(tracing.diagnosis, "effects", (claim,))
    return tracing


@pytest.mark.parametrize(
    ("hidden", "tracing", "standing"),
    [
        ("vane-offset", claimed("vane-offset"), Standing.RIGHT),
        (
            "vane-offset",
            claimed("sensor-lag:q", "vane-offset", verdict=Verdict.AMBIGUOUS),
            Standing.AMONG,
        ),
        ("vane-offset", claimed("sensor-lag:q"), Standing.WRONG),
        ("sensor-lag:q", claimed("sensor-delay:q"), Standing.RIGHT),
        ("elastic-mode", claimed("elastic-mode#2"), Standing.RIGHT),
        (
            "vane-offset",
            claimed("sensor-lag:q", "input-delay", verdict=Verdict.AMBIGUOUS),
            Standing.BESIDE,
        ),
        ("", claimed("vane-offset"), Standing.WRONG),
    ],
)
def test_an_answer_is_right_or_wrong_by_what_was_hidden(
    hidden: str, tracing: Any, standing: Standing
) -> None:
    marked = scored_flight_of(flown(hidden), tracing)
    assert marked.standing is standing and marked.right is (
        standing in (Standing.RIGHT, Standing.AMONG)
    )
    assert bool(marked.false) is not marked.right


def flown(hidden: str, values: dict[str, float] | None = None) -> Any:
    carrier = drawn_carrier("rigid", np.random.default_rng(1))
    return Flown(carrier, hidden, values or {}, 20.0, None, None)  # type: ignore[arg-type]


def test_numbers_are_held_against_the_truth_in_their_sigmas() -> None:
    marked = scored_flight_of(
        flown("vane-offset", {"arm": 5.0}), claimed("vane-offset", arm=(5.6, 0.4))
    )
    assert marked.errors == pytest.approx({"vane-offset.arm": 1.5})
    assert [(each.name, each.probability, each.first, each.right) for each in marked.stated] == [
        ("vane-offset", 0.7, True, True)
    ]
    bent = scored_flight_of(
        flown("moment-nonlinearity", {"shape1": 0.1}),
        claimed("moment-nonlinearity", shape1=(0.2, 0.1)),
    )
    assert not bent.errors, "coefficients of a curve hang on the range of the record"


@pytest.mark.long
def test_the_command_writes_a_row_a_flight_and_flies_one_of_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    falls = (Instance("ballistic", "density-scale-height"),)
    monkeypatch.setattr(work, "chosen", lambda asked: {"density-scale-height": falls})
    named = ["every-effect", "--effects", "density-scale-height", "--seed", "3"]
    assert main([*named, "--runs", "2", "--jobs", "1", "--out", str(tmp_path / "c")]) == 0
    assert "every-effect: 2 flights, seeds from 3" in capsys.readouterr().out
    rows = [*csv.DictReader((tmp_path / "c" / "flights.csv").read_text().splitlines())]
    content = json.loads((tmp_path / "c" / "campaign.json").read_text())
    assert (content["runs"], content["flights"], content["seed"]) == (2, 2, 3) and content["marks"][
        "rates"
    ]["density-scale-height"]["right"]["count"] == 2
    assert (tmp_path / "c" / "report.html").is_file() and [row["right"] for row in rows] == [
        "True",
        "True",
    ]
    assert main([*named, "--only", "1", "--out", str(tmp_path / "one"), "--no-figures"]) == 0
    assert "flight 1: hidden was density-scale-height (change" in capsys.readouterr().out
    truth = json.loads((tmp_path / "one" / "truth.json").read_text())
    assert truth["seed"] == int(rows[1]["seed"]) and truth["hidden"][
        "density-scale-height"
    ] == json.loads(rows[1]["values"])
    found = json.loads((tmp_path / "one" / "diagnosis.json").read_text())
    (claim,) = found["effects"]
    change, true = claim["parameters"]["change"], truth["hidden"]["density-scale-height"]["change"]
    assert (change["value"] - true) / change["std"] == pytest.approx(
        float(rows[1]["error_sigmas"]), rel=1e-6
    )
    assert (tmp_path / "one" / "train.csv").is_file() and (
        tmp_path / "one" / "vehicle.toml"
    ).is_file()
