"""What holds for every figure: units at the axes, nothing cut off or covered, the same bytes, no pyplot."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from scenarios.plots.ballistic import figure_ballistic_coefficient, figure_trajectory
from scenarios.plots.comparison import ComparisonRow, EquivalentRow, figure_comparison, figure_equivalents
from scenarios.plots.correlation import figure_correlation
from scenarios.plots.files import figure_png, save_figure
from scenarios.plots.innovations import figure_innovations
from scenarios.plots.parameters import figure_parameter_histories
from scenarios.plots.signals import Response, figure_fit, figure_record, response_of
from tests.unit.scenarios.plots.conftest import Study

ROOT = Path(__file__).parents[4]
Studies = Mapping[str, Study]


def _parameters(study: Study) -> Figure:
    estimate = study.estimate
    true = {name: study.truth.parameters[name].value for name in estimate.names}
    far = {name: (5.0 * value, abs(value)) for name, value in true.items()}
    return figure_parameter_histories(study.history, estimate.names, estimate.units, true, far, far, "Parameters over time")


def _fit(study: Study) -> Figure:
    again = Response("a second method with a long name of its own", study.truth.outputs)
    return figure_fit(study.record, [response_of(study.estimate), again], study.truth, "Measured and estimated", {"q": 0.002})


def _comparison(study: Study) -> Figure:
    estimate = study.estimate
    rows = [
        ComparisonRow(name, study.truth.parameters[name].value, estimate.value(name), estimate.sigma(name), 1.1 * estimate.value(name), 1e-3)
        for name in estimate.names
    ]
    return figure_comparison([*rows, ComparisonRow("beta", 500.0, 499.0, 0.3, label="β with two Taylor terms")], "Errors")


def _equivalents(study: Study) -> Figure:
    rows = [EquivalentRow(craft, name, "1/rad", 2.9, 2.5, 2.4, 0.1, 2.3, 0.1) for craft in ("AC1", "AC2") for name in study.estimate.names]
    return figure_equivalents(rows, "Equivalent derivatives")


FIGURES: dict[str, Callable[[Studies], Figure]] = {
    "record": lambda s: figure_record(s["rigid"].record, "A record"),
    "fit": lambda s: _fit(s["rigid"]),
    "fit-broken": lambda s: figure_fit(s["broken"].record, [response_of(s["broken"].estimate)]),
    "innovations": lambda s: figure_innovations(s["rigid"].history, ("alpha", "q"), ("rad", "rad/s"), "Innovations"),
    "innovations-broken": lambda s: figure_innovations(s["broken"].history, ("alpha", "q"), ("rad", "rad/s"), "Innovations"),
    "parameters": lambda s: _parameters(s["rigid"]),
    "parameters-broken": lambda s: _parameters(s["broken"]),
    "parameters-few": lambda s: figure_parameter_histories(s["2"].history, ["beta", "altitude"], ["kg/m2", "m"]),
    "trajectory": lambda s: figure_trajectory(s["2"].record, {"two": s["2"].history, "three": s["3"].history}, s["2"].truth, "Trajectory"),
    "beta": lambda s: figure_ballistic_coefficient({"two": s["2"].history, "three": s["3"].history}, 2441.2, title="Ballistic coefficient"),
    "comparison": lambda s: _comparison(s["rigid"]),
    "equivalents": lambda s: _equivalents(s["rigid"]),
    "correlation": lambda s: figure_correlation(s["rigid"].estimate.names, s["rigid"].estimate.correlation, "Correlation"),
    "correlation-long": lambda s: figure_correlation(("input-delay.delay", "sensor-lag:alpha.time"), np.array([[1.0, -0.95], [-0.95, 1.0]])),
}


@pytest.fixture(scope="module")
def studies(rigid: Study, broken: Study, falls: dict[str, Study]) -> Studies:
    return {"rigid": rigid, "broken": broken, "2": falls["2 Taylor terms"], "3": falls["3 Taylor terms"]}


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_is_cut_off_or_covered(name: str, studies: Studies) -> None:
    figure = FIGURES[name](studies)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    sheet = figure.bbox.padded(1.0)
    for text in drawn_texts(figure):
        box = text.get_window_extent(renderer)
        inside = sheet.x0 <= box.x0 and box.x1 <= sheet.x1 and sheet.y0 <= box.y0 and box.y1 <= sheet.y1
        assert inside, f"{text.get_text()!r} leaves the figure"
    for legend in figure.legends:
        covered = legend.get_window_extent(renderer)
        assert not any(covered.overlaps(panel.get_window_extent(renderer)) for panel in figure.axes)
    for i, panel in enumerate(figure.axes):
        for other in figure.axes[i + 1 :]:
            assert not panel.get_window_extent(renderer).overlaps(other.get_window_extent(renderer))


def drawn_texts(figure: Figure) -> list[Text]:
    """Every text that is seen; of the ticks those within the limits, since matplotlib keeps others in store."""
    axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]
    stored = {id(label) for axis in axes for tick in (*axis.majorTicks, *axis.minorTicks) for label in (tick.label1, tick.label2)}
    shown = [tick.label1 for axis in axes for tick in axis._update_ticks()]  # type: ignore[union-attr]
    others = [text for text in figure.findobj(Text) if id(text) not in stored]
    return [text for text in (*others, *shown) if isinstance(text, Text) and text.get_visible() and text.get_text()]


@pytest.mark.parametrize("name", FIGURES)
def test_every_panel_carries_units(name: str, studies: Studies) -> None:
    panels = FIGURES[name](studies).axes
    for panel in panels:
        # Panels side by side with the same quantity carry its label once, at the left.
        row = [other for other in panels if other.get_position().y0 == panel.get_position().y0]
        words = " ".join((panel.get_xlabel(), row[0].get_ylabel(), panel.get_ylabel(), panel.get_title(loc="left")))
        pure_number = "autocorrelation" in words or "too few samples" in words or name.startswith("correlation")
        assert "(" in words or pure_number, words
        lowest = panel.xaxis.get_tick_params()["labelbottom"]
        assert not lowest or panel.get_xlabel() or name.startswith(("correlation", "equivalents"))


def test_same_result_same_bytes(studies: Studies, tmp_path: Path) -> None:
    for name in ("fit", "parameters"):
        first, second = (figure_png(FIGURES[name](studies)) for _ in range(2))
        assert first == second
        # Neither a date nor a program's version: no chunk of text in the file.
        assert not any(chunk in first for chunk in (b"tEXt", b"iTXt", b"zTXt", b"tIME"))
    (path,) = save_figure(FIGURES["fit"](studies), tmp_path, "fit")
    assert path == tmp_path / "fit.png"
    assert path.read_bytes() == figure_png(FIGURES["fit"](studies))


PROBE = """
import hashlib, sys
import numpy as np
from scenarios.plots.comparison import ComparisonRow, figure_comparison
from scenarios.plots.files import figure_png
import scenarios.plots.ballistic, scenarios.plots.correlation, scenarios.plots.innovations, scenarios.plots.parameters, scenarios.plots.signals
png = figure_png(figure_comparison([ComparisonRow("CL_alpha", 2.9, 2.8, 0.1, 9.0, 0.1)], "One"))
print("matplotlib.pyplot" in sys.modules, hashlib.sha256(png).hexdigest())
"""


def test_pyplot_stays_out_and_a_fresh_process_draws_the_same() -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7", "MPLBACKEND": "svg"}
    run = subprocess.run([sys.executable, "-c", PROBE], env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    here = figure_png(figure_comparison([ComparisonRow("CL_alpha", 2.9, 2.8, 0.1, 9.0, 0.1)], "One"))
    assert run.stdout.split() == ["False", hashlib.sha256(here).hexdigest()]
