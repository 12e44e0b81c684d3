"""Laws of every figure of every kind of study: texts apart and on the canvas, units, legends,
coincident lines told apart; and that the laws bite.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.files import figures_of, pictured
from scenarios.plots.comparisons import (
    figure_studies_errors,
    figure_studies_estimates,
    figure_studies_responses,
)
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA, StudyResponses, StudyValue
from scenarios.plots.low_order import (
    Bar,
    LikelihoodCurve,
    figure_delays,
    figure_peaks,
    figure_side_by_side,
    figure_states,
)
from scenarios.plots.studies import (
    Coverage,
    CoverageRow,
    DeterminedBy,
    SquaresPanel,
    figure_campaign,
    figure_coverage,
    figure_determination,
    figure_errors,
    figure_squares,
)
from scenarios.plots.style import make_sheet
from tests.diagnoses import BALLISTIC, LOES, spread_tracing, tracing_of
from tests.figure_laws import broken_laws, words
from tests.unit.scenarios.plots.conftest import Study
from tests.unit.scenarios.plots.test_sheets import FIGURES

TRACINGS = {
    "consistent": lambda: tracing_of(Verdict.CONSISTENT, count=80),
    "ambiguous": lambda: tracing_of(Verdict.AMBIGUOUS, LOES, count=80),
    "unexplained": lambda: tracing_of(
        Verdict.UNEXPLAINED, BALLISTIC, channels=("altitude",), count=80
    ),
    "partial": spread_tracing,
}


def _sweep(rng: np.random.Generator) -> Figure:
    return figure_campaign(
        [
            Coverage(name, rng.standard_normal(40), 95.0, (88.0, 99.0))
            for name in ("CL_alpha", "Cm_q", "all")
        ],
        "a scenario\nan estimator: 40 runs",
    )


def _responses() -> Figure:
    time = np.linspace(0.0, 4.0, 50)
    row = {"alpha": 0.1 * np.sin(time)}
    units = {"alpha": "rad", "elevator": "rad"}
    studies = {
        f"study {number}": StudyResponses(time, {"elevator": 0.0 * time}, row, row, {}, units, True)
        for number in range(4)
    }
    return figure_studies_responses(studies, ["alpha"], "studies side by side")


COLUMNS: Mapping[str, list[StudyValue | None]] = {
    "Cm_q": [
        StudyValue(-33.0, 1.0, "1/rad", -34.0, -32.0, (-20.0, 6.0)),
        StudyValue(-60.0, 2.0, "1/rad", -34.0),
    ],
    "natural_frequency": [StudyValue(4.1, 0.1, "rad/s", 4.2), None],
}
UNITS = {"Cm_q": "1/rad", "natural_frequency": "rad/s"}
BARS = {
    "L_alpha": Bar(-2.06, 0.02, "1/s"),
    "L_delta": Bar(1e-4, 3e-4, "1/s"),
    "natural_frequency": Bar(4.7, 0.1, "rad/s"),
}
CURVE = LikelihoodCurve(
    np.linspace(0.0, 0.2, 9), -(np.linspace(-3.0, 3.0, 9) ** 4), 0.1, 0.1, 0.107, 0.002
)
BY = DeterminedBy(
    "output error",
    {"CL_alpha": 0.1, "Cm_q": 0.4},
    {"CL_alpha": 0.2, "Cm_q": 0.7},
    np.array([30.0, 0.2]),
    1,
)
COVERED = CoverageRow("Cm_q", ((66.0, 60.0, 72.0), (95.0, 93.0, 97.0), (98.0, 97.0, 99.0)))
OTHERS: dict[str, Callable[[], Figure]] = {
    "campaign": lambda: _sweep(np.random.default_rng(1)),
    "compared_estimates": lambda: figure_studies_estimates(
        COLUMNS, UNITS, ["one", "a study with a very long name of its own"], "studies"
    ),
    "compared_errors": lambda: figure_studies_errors(COLUMNS, ["one", "two"], "studies"),
    "compared_responses": _responses,
    "side_by_side": lambda: figure_side_by_side(BARS, BARS, "flown", "this study", "two estimates"),
    "delays": lambda: figure_delays(CURVE, "delays"),
    "variants": lambda: figure_peaks(
        [("as declared", 12.0), ("a variant with a long name", -3.0)],
        "final peak of q (%)",
        "variants",
    ),
    "coverage": lambda: figure_coverage([COVERED] * 3, [68.3, 95.4, 99.7], "coverage"),
    "normality": lambda: figure_errors(
        ("CL_alpha", "Cm_q"),
        np.random.default_rng(1).normal(0.0, [[1.0], [1.6]], (2, 300)),
        "errors",
    ),
    "consistency": lambda: figure_squares(
        [
            SquaresPanel(name, np.random.default_rng(1).chisquare(dof, 200) / dof, dof)
            for name, dof in (("NEES", 6.0), ("NIS", 800.0))
        ],
        "squares",
    ),
    "determination": lambda: figure_determination(
        [BY, replace(BY, label="filter")], "determination"
    ),
}


@pytest.mark.sampled
@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_records_and_estimates_obey(
    name: str, rigid: Study, broken: Study, falls: dict[str, Study]
) -> None:
    studies = {
        "rigid": rigid,
        "broken": broken,
        "2": falls["2 Taylor terms"],
        "3": falls["3 Taylor terms"],
    }
    assert broken_laws(FIGURES[name](studies)) == []


@pytest.mark.sampled
@pytest.mark.parametrize("name", OTHERS)
def test_figures_of_several_studies_obey(name: str) -> None:
    assert broken_laws(OTHERS[name]()) == []


def test_states_of_a_filter_obey(rigid: Study) -> None:
    assert (
        broken_laws(figure_states(rigid.history, ("alpha", "q"), ("rad", "rad/s"), "states")) == []
    )


@pytest.mark.long
@pytest.mark.parametrize("verdict", TRACINGS)
def test_figures_of_a_diagnosis_obey_and_a_simulated_record_is_never_called_measured(
    verdict: str,
) -> None:
    shown = pictured(replace(TRACINGS[verdict](), simulated=True))
    assert shown.data == SIMULATED_DATA
    for stem, make in figures_of(shown):
        figure = make()
        assert broken_laws(figure) == [], stem
        # Names of effects may hold the word.
        told = words(figure).replace("unmeasured", "")
        assert MEASURED_DATA not in told, stem
        assert verdict != "unexplained" or ("after" not in told and "before" not in told), stem


def test_the_laws_bite() -> None:
    sheet = make_sheet([1.0, 1.0])
    first, second = sheet.panels
    first.plot([0.0, 1.0, 2.0], [0.0, 1.0, 4.0], color="black", label="one")
    first.plot([0.0, 1.0, 2.0], [0.0, 1.0, 4.0], color="blue", label="other")
    second.text(0.5, 0.5, "a text", transform=second.transAxes)
    second.text(0.5, 0.5, "another", transform=second.transAxes)
    second.text(3.0, 0.5, "outside", transform=second.transAxes)
    first.legend(first.lines[:2], ["twice", "twice"])
    sheet.figure.set_size_inches(7.0, 3.0)
    first.set_position((0.1, 0.6, 0.8, 0.3))
    second.set_position((0.1, 0.1, 0.8, 0.3))
    found = " ".join(broken_laws(sheet.figure))
    for law in (
        "coincide",
        "lie over each other",
        "leaves the figure",
        "twice",
        "has no unit",
        "covers a panel",
    ):
        assert law in found, law
