"""The page of a study with several methods: one table of each kind, what else is said folded."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from scenarios.report.document import Fold, Number, Section, Table
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.page import study_page
from scenarios.studies.study import StudyResult, run_scenario

SHORT = ["flight.duration=3", "flight.rate=20", "flight.step=0.01"]


def tables(sections: tuple[Section, ...]) -> Iterator[Table]:
    for each in sections:
        yield from (block for block in each.blocks if isinstance(block, Table))
        yield from tables(each.parts)


@pytest.fixture(scope="module")
def study() -> StudyResult:
    return run_scenario(load_scenario("rigid-process-noise-a", SHORT))


def test_methods_are_side_by_side(study: StudyResult) -> None:
    page = study_page(study)
    captions = [table.caption for table in tables(page.sections)]
    assert len(captions) == len(set(captions))
    (estimates,) = (each for each in tables(page.sections) if "Estimates of all" in each.caption)
    labels = [column.heading for column in estimates.columns[2:]]
    assert [each.lower() for each in labels] == [
        method.estimation.label.lower() for method in study.methods
    ]
    for column, method in enumerate(study.methods, start=2):
        for row, shown in zip(estimates.rows, method.rows, strict=True):
            cell = row[column]
            assert isinstance(cell, Number)
            assert (cell.value, cell.sigma) == (shown.estimate, shown.std)


def test_what_is_said_of_other_methods_is_folded(study: StudyResult) -> None:
    (others,) = (each for each in study_page(study).sections if each.title == "Other methods")
    folds = [block for block in others.blocks if isinstance(block, Fold)]
    assert len(folds) == len(study.methods) - 1 and not others.parts
    assert all(fold.items[0].startswith("Converged") for fold in folds)


def test_methods_of_one_label_have_their_names() -> None:
    """Two flights by one method: neither column of the page takes the place of the other."""
    own = '[{input="elevator", kind="doublet", amplitude=0.05, unit="0.5 s", start="1 s"}]'
    changes = [*SHORT, f'methods=[{{name="doublet", explanation="x", flight={{maneuvers={own}}}}}]']
    page = study_page(run_scenario(load_scenario("rigid", changes)))
    (estimates,) = (each for each in tables(page.sections) if "Estimates of all" in each.caption)
    assert [column.heading for column in estimates.columns[2:]] == [
        "Extended Kalman filter (main)",
        "Extended Kalman filter (doublet)",
    ]
