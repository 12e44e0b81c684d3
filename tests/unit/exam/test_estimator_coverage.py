"""The coverage campaign of the estimators: its statistics, its file of runs, its table, and the
page that holds it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exam.coverage import estimators
from exam.coverage.estimators import (
    BEGIN,
    END,
    HIGH,
    LOW,
    cells,
    main,
    measure,
    read_rows,
    run_of,
    statistics,
    table,
)
from scenarios.identification.cautions import SHORT_IN_GUSTS

PAGE = Path(__file__).parents[3] / "docs" / "estimators.md"


def rows_with(errors: np.ndarray, **more: Any) -> list[dict[str, Any]]:
    base = {
        "estimator": "ekf",
        "model": "rigid",
        "noise": "white",
        "outcome": "converged",
        "cautioned": False,
    }
    return [
        {**base, "run": k, "errors": {f"C{i}": float(v) for i, v in enumerate(each)}, **more}
        for k, each in enumerate(errors)
    ]


def test_normal_errors_are_covered_and_small_sigmas_are_not() -> None:
    rng = np.random.default_rng(1)
    sound = statistics(rows_with(rng.standard_normal((400, 5))))
    assert sound["runs"] == sound["settled"] == 400 and sound["low"] < 0.9545 < sound["high"]
    assert sound["scale"] == pytest.approx(1.0, abs=0.05) and sound["bias"] < 0.2
    short = statistics(rows_with(1.5 * rng.standard_normal((400, 5))))
    assert short["high"] < 0.9 and short["scale"] == pytest.approx(1.5, abs=0.08)
    # Five parameters that err together are as good as one: the interval is as wide as of 400
    # trials.
    together = statistics(rows_with(np.repeat(rng.standard_normal((400, 1)), 5, axis=1)))
    assert together["high"] - together["low"] > 1.8 * (sound["high"] - sound["low"])


def test_runs_that_did_not_settle_are_counted_and_not_judged() -> None:
    rows = (
        rows_with(np.zeros((3, 2)))
        + rows_with(np.full((1, 2), 9.0), outcome="max-iterations")
        + rows_with(np.zeros((1, 0)), outcome="refused")
    )
    found = statistics(rows)
    assert (found["runs"], found["settled"], found["share"]) == (5, 3, 1.0)
    assert statistics([]) == {"runs": 0, "settled": 0, "cautioned": 0}


def test_cells_are_chosen_by_their_words() -> None:
    assert len(cells()) == 6 * 3 * 4 - 4
    assert ("frequency-domain", "longitudinal", "white") not in cells()
    assert cells(["ekf,lateral", "ukf,rigid,ar1"]) == [
        *(("ekf", "lateral", "white"), ("ukf", "rigid", "ar1"), ("ekf", "lateral", "ar1")),
        *(("ekf", "lateral", "markov-gusts"), ("ekf", "lateral", "dryden-gusts")),
    ]


def test_a_stopped_campaign_goes_on_where_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, int]] = []

    def counted(cell: tuple[str, str, str], run: int) -> dict[str, Any]:
        asked.append((cell, run))
        return {
            "estimator": cell[0],
            "model": cell[1],
            "noise": cell[2],
            "run": run,
            "outcome": "converged",
            "errors": {"C": 0.1},
        }

    monkeypatch.setattr(estimators, "run_of", counted)
    rows, wanted = tmp_path / "rows.jsonl", cells(["ekf,rigid"])
    measure(rows, wanted, 2)
    measure(rows, wanted, 3)
    assert len(asked) == len(set(asked)) == 3 * len(wanted) == len(read_rows(rows))
    measure(rows, wanted, 1, first=7)
    assert asked[-1] == (wanted[-1], 7)


def test_the_table_goes_between_the_marks_of_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, page = tmp_path / "rows.jsonl", tmp_path / "page.md"
    rows.write_text(
        "".join(json.dumps(each) + "\n" for each in rows_with(np.zeros((4, 2)))), encoding="utf-8"
    )
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    assert main([str(rows), "--page", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert (
        text.startswith("before")
        and text.endswith("after\n")
        and "old" not in text
        and "| white | rigid | ekf | 4 | 4 | 100.0 %" in text
    )
    assert main([str(rows)]) == 0 and table(read_rows(rows)) in capsys.readouterr().out
    page.write_text("no marks", encoding="utf-8")
    assert main([str(rows), "--page", str(page)]) == 2
    error = capsys.readouterr().err
    assert (
        error.count("\n") == 1
        and "has no marks" in error
        and page.read_text(encoding="utf-8") == "no marks"
    )


def test_a_run_identifies_as_a_user_would() -> None:
    row = run_of(("output-error", "rigid", "white"), 0)
    assert row["outcome"] == "converged" and not row["cautioned"] and len(row["errors"]) == 6
    assert max(abs(value) for value in row["errors"].values()) < 4.0
    assert run_of(("frequency-domain", "longitudinal", "white"), 0)["outcome"] == "refused"


def _page_rows() -> list[list[str]]:
    text = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    return [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in text.splitlines()
        if line.startswith("| ") and "noise" not in line
    ]


def test_every_cell_of_the_page_is_honest_or_cautioned() -> None:
    """No cell lies outside 93 to 97 % by more than chance without a caution in nine of ten of its
    results.
    """
    rows = _page_rows()
    assert len(rows) >= 16
    for noise, model, estimator, _, settled, share, interval, _, _, cautioned in rows:
        if share == "-" or int(settled) < 20:
            continue
        low, high = (float(each) / 100.0 for each in interval.removesuffix(" %").split(" to "))
        outside = high < LOW or low > HIGH
        assert not outside or float(cautioned.removesuffix(" %")) >= 90.0, (
            noise,
            model,
            estimator,
            share,
        )


@pytest.mark.parametrize("estimator", sorted(SHORT_IN_GUSTS))
def test_cautions_say_what_the_page_has(estimator: str) -> None:
    """The share that a caution states lies in the interval of the cell in gusts that is worst."""
    cells_in_gusts = []
    for noise, _, name, _, _, share, interval, *_ in _page_rows():
        if name == estimator and noise.endswith("gusts") and share != "-":
            low, high = (float(each) for each in interval.removesuffix(" %").split(" to "))
            cells_in_gusts.append((float(share.removesuffix(" %")), low, high))
    _, low, high = min(cells_in_gusts)
    *_, held = SHORT_IN_GUSTS[estimator]
    assert low <= 100.0 * held <= high
