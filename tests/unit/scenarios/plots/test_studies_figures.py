"""Figures of several studies, structures and methods draw what they are given: places, arrows,
lines where a criterion fails, counts.
"""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes

from scenarios.plots.comparisons import (
    CLIPPED_PERCENT,
    figure_studies_errors,
    figure_studies_estimates,
    figure_studies_responses,
)
from scenarios.plots.display import StudyResponses, StudyValue
from scenarios.plots.studies import (
    CriterionCourse,
    DerivativeCourse,
    DeterminedBy,
    Published,
    figure_determination,
    figure_flexibility,
)

ROWS: dict[str, list[StudyValue | None]] = {
    "CL_alpha": [StudyValue(2.9, 0.1, "1/rad", 3.0, None, (3.4, 0.05)), None],
    "Cm_q": [StudyValue(-30.0, 1.0, "1/rad", -33.0, -31.0), StudyValue(-60.0, 2.0, "1/rad", -33.0)],
}


def first_points(panel: Axes) -> list[tuple[float, float]]:
    """First points of the lines with one point or more, horizontal and vertical rules left out."""
    lines = [line for line in panel.lines if len(np.atleast_1d(line.get_xdata())) == 1]
    return [
        (float(np.atleast_1d(line.get_xdata())[0]), float(np.atleast_1d(line.get_ydata())[0]))
        for line in lines
    ]


def test_errors_are_against_the_condensed_value_and_large_ones_are_arrows_with_their_size() -> None:
    percent, sigmas = figure_studies_errors(ROWS, ["one", "two"]).axes
    at = [x for x, _ in first_points(percent)]
    assert at == pytest.approx(
        [100 * -0.1 / 3.0, 100 * 0.4 / 3.0, 100 * 1.0 / 31.0, -1.06 * CLIPPED_PERCENT]
    )
    assert [text.get_text() for text in percent.texts] == ["−82 %"]
    assert [x for x, _ in first_points(sigmas)][:3] == pytest.approx([-1.0, 8.0, 1.0])
    assert [text.get_text() for text in sigmas.texts] == ["−14 σ"]
    heights = [y for _, y in first_points(percent)]
    assert heights == sorted(heights, reverse=True) and len(set(heights)) == 4, (
        "no mark covers another"
    )


def test_long_names_of_studies_are_numbered_and_told_in_the_title() -> None:
    units = {"CL_alpha": "1/rad", "Cm_q": "1/rad"}
    figure = figure_studies_estimates(
        ROWS, units, ["a-study-with-a-very-long-name", "two"], "title"
    )
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1", "2"]
    assert "1: a-study-with-a-very-long-name" in [text.get_text() for text in figure.texts]


def test_responses_of_studies_are_over_each_other_in_degrees() -> None:
    time = np.linspace(0.0, 1.0, 11)
    row = {"alpha": 0.1 * time}
    studies = {
        label: StudyResponses(
            time, {"elevator": time}, row, {"alpha": scale * time}, {}, {"alpha": "rad"}
        )
        for label, scale in (("a", 0.1), ("b", 0.2))
    }
    figure = figure_studies_responses(studies, ["alpha"])
    (panel,) = figure.axes[1:]
    ends = {
        str(line.get_label()): float(np.asarray(line.get_ydata())[-1])
        for line in panel.lines
        if str(line.get_label()) in "ab"
    }
    assert ends == pytest.approx({"a": np.degrees(0.1), "b": np.degrees(0.2)})


def test_a_line_stands_where_a_criterion_fails_in_every_panel() -> None:
    degrees = [0.001, 0.01, 0.1]
    course = DerivativeCourse(
        "Cm_q",
        "1/rad",
        -34.0,
        [-33.0, -30.0, -20.0],
        [-33.0, -29.0, -15.0],
        {"f": [(-33.0, 0.1)] * 3},
        [Published(0.1, -15.0, 6.0)],
    )
    criteria = [
        CriterionCourse("axis", "fails", 0.0, [-1.0, -500.0, 9.0], 0.02, (-10.0, 5.0)),
        CriterionCourse("other", "never", 0.0, [1.0] * 3, None),
    ]
    figure = figure_flexibility(degrees, [course] * 3, criteria, {"AC2": 0.1})
    for panel in figure.axes:
        (line,) = [line for line in panel.lines if line.get_label() == "fails"]
        assert np.asarray(line.get_xdata(), dtype=float) == pytest.approx([0.02, 0.02])
        assert not [line for line in panel.lines if line.get_label() == "never"]
    assert [text.get_text() for text in figure.axes[0].texts] == ["AC2"] and not figure.axes[
        3
    ].texts
    drawn = np.asarray(figure.axes[3].lines[0].get_ydata(), dtype=float)
    assert drawn == pytest.approx([-1.0, -10.0, 5.0]), (
        "what is beyond the window is drawn at its edge"
    )


def test_parameters_that_keep_their_prior_are_counted_and_not_drawn() -> None:
    ratio = {"a": 0.2, "b": 0.99, "c": 0.6, "d": 1.0}
    one = DeterminedBy("one", ratio, dict.fromkeys(ratio, 0.5), np.array([5.0, 1.0]), 2)
    spectrum, added, rows, shares = figure_determination([one]).axes
    assert [label.get_text() for label in rows.get_yticklabels()] == ["a", "c"]
    assert "2 further parameters" in rows.get_title(loc="left")
    assert "2 more do not change the outputs" in spectrum.get_xlabel()
    settled = next(line for line in added.lines if len(np.asarray(line.get_ydata())) == 2)
    assert np.asarray(settled.get_ydata(), dtype=float) == pytest.approx([25 / 26, 25 / 26 + 0.5])
    assert np.asarray(shares.lines[0].get_xdata(), dtype=float) == pytest.approx([50.0, 50.0])
