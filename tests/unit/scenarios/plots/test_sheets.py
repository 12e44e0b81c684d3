"""Figures of records and estimates, for the laws that hold for every figure; the same bytes in
every format, no pyplot.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from scenarios.plots.comparisons import (
    ComparisonRow,
    EquivalentRow,
    figure_comparison,
    figure_equivalents,
)
from scenarios.plots.drawing import figure_pdf, figure_png, figure_svg, page_svg, save_figure
from scenarios.plots.estimates import (
    figure_correlation,
    figure_innovations,
    figure_parameter_histories,
)
from scenarios.plots.signals import (
    MethodOutputs,
    figure_ballistic_coefficient,
    figure_fit,
    figure_record,
    figure_trajectory,
    response_of,
)
from scenarios.report.figure_formats import FORMATS, Formats, formats_of, formats_wanted
from sim.errors import DeclarationError
from tests.unit.scenarios.plots.conftest import Study

ROOT = Path(__file__).parents[4]
Studies = Mapping[str, Study]


def _parameters(study: Study) -> Figure:
    estimate = study.estimate
    true = {name: study.truth.parameters[name].value for name in estimate.names}
    far = {name: (5.0 * value, abs(value)) for name, value in true.items()}
    return figure_parameter_histories(
        study.history, estimate.names, estimate.units, true, far, far, "Parameters over time"
    )


def _fit(study: Study) -> Figure:
    again = MethodOutputs("a second method with a long name of its own", study.truth.outputs)
    return figure_fit(
        study.record,
        [response_of(study.estimate), again],
        study.truth,
        "Measured and estimated",
        {"q": 0.002},
    )


def _comparison(study: Study) -> Figure:
    estimate = study.estimate
    rows = [
        ComparisonRow(
            name,
            study.truth.parameters[name].value,
            estimate.value(name),
            estimate.sigma(name),
            1.1 * estimate.value(name),
            1e-3,
        )
        for name in estimate.names
    ]
    return figure_comparison(
        [*rows, ComparisonRow("beta", 500.0, 499.0, 0.3, label="β with two Taylor terms")], "Errors"
    )


def _equivalents(study: Study) -> Figure:
    rows = [
        EquivalentRow(craft, name, "1/rad", 2.9, 2.5, 2.4, 0.1, 2.3, 0.1)
        for craft in ("AC1", "AC2")
        for name in study.estimate.names
    ]
    return figure_equivalents(rows, "Equivalent derivatives")


FIGURES: dict[str, Callable[[Studies], Figure]] = {
    "record": lambda s: figure_record(s["rigid"].record, "A record"),
    "fit": lambda s: _fit(s["rigid"]),
    "fit-broken": lambda s: figure_fit(s["broken"].record, [response_of(s["broken"].estimate)]),
    "innovations": lambda s: figure_innovations(
        s["rigid"].history, ("alpha", "q"), ("rad", "rad/s"), "Innovations"
    ),
    "innovations-broken": lambda s: figure_innovations(
        s["broken"].history, ("alpha", "q"), ("rad", "rad/s"), "Innovations"
    ),
    "parameters": lambda s: _parameters(s["rigid"]),
    "parameters-broken": lambda s: _parameters(s["broken"]),
    "parameters-few": lambda s: figure_parameter_histories(
        s["2"].history, ["beta", "altitude"], ["kg/m2", "m"]
    ),
    "trajectory": lambda s: figure_trajectory(
        s["2"].record, {"two": s["2"].history, "three": s["3"].history}, s["2"].truth, "Trajectory"
    ),
    "beta": lambda s: figure_ballistic_coefficient(
        {"two": s["2"].history, "three": s["3"].history}, 2441.2, title="Ballistic coefficient"
    ),
    "comparison": lambda s: _comparison(s["rigid"]),
    "equivalents": lambda s: _equivalents(s["rigid"]),
    "correlation": lambda s: figure_correlation(
        s["rigid"].estimate.names, s["rigid"].estimate.correlation, "Correlation"
    ),
    "correlation-long": lambda s: figure_correlation(
        ("input-delay.delay", "sensor-lag:alpha.time"), np.array([[1.0, -0.95], [-0.95, 1.0]])
    ),
}


@pytest.fixture(scope="module")
def studies(rigid: Study, broken: Study, falls: dict[str, Study]) -> Studies:
    return {
        "rigid": rigid,
        "broken": broken,
        "2": falls["2 Taylor terms"],
        "3": falls["3 Taylor terms"],
    }


@pytest.mark.long
def test_same_result_same_bytes(studies: Studies, tmp_path: Path) -> None:
    for write in (figure_png, figure_svg, figure_pdf):
        first, second = (write(FIGURES["fit"](studies)) for _ in range(2))
        assert first == second
        # Neither a date nor a program's version: no chunk of text in a PNG, no entry in the others.
        assert not any(
            chunk in first
            for chunk in (
                b"tEXt",
                b"iTXt",
                b"zTXt",
                b"tIME",
                b"Date",
                b"Creator",
                b"Producer",
                b"Matplotlib v",
            )
        )
    paths = save_figure(FIGURES["fit"](studies), tmp_path, "fit", FORMATS)
    assert [path.name for path in paths] == ["fit.png", "fit.svg", "fit.pdf"]
    assert paths[0].read_bytes() == figure_png(FIGURES["fit"](studies))


@pytest.mark.long
def test_figure_of_a_page_stands_alone_and_shares_no_name_with_another(studies: Studies) -> None:
    figure = FIGURES["correlation"](studies)
    one, other = (ElementTree.fromstring(page_svg(figure, name)) for name in ("one", "other"))
    assert one.tag == "svg" and one.get("aria-label") and one.get("viewBox")
    assert "mapped" in str(one.get("class")).split()
    names = [
        {element.get("id") for element in root.iter() if element.get("id")} for root in (one, other)
    ]
    assert names[0] and not names[0] & names[1]
    text = page_svg(figure, "one")
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))
    assert used and used <= names[0], "every reference leads to something of its own"
    assert "<style" not in text and "<image" not in text and " style=" not in text


@pytest.mark.parametrize(
    ("asked", "none", "given"),
    [
        (None, False, ("png",)),
        (["pdf,png"], False, ("png", "pdf")),
        (["svg", "SVG", " pdf"], False, ("svg", "pdf")),
        (["none"], False, ()),
        (None, True, ()),
        (["none"], True, ()),
    ],
)
def test_formats_are_those_that_are_asked_for(
    asked: list[str] | None, none: bool, given: Formats
) -> None:
    assert formats_of(asked, none) == given


@pytest.mark.parametrize(
    ("asked", "none"),
    [(["jpg"], False), (["png,none"], False), (["svg"], True), ([""], False), (["png,"], False)],
)
def test_formats_that_are_none_are_refused(asked: list[str], none: bool) -> None:
    with pytest.raises(DeclarationError, match="--figures"):
        formats_of(asked, none)


def test_formats_from_python() -> None:
    assert [formats_wanted(each) for each in (True, False, "svg", ["pdf", "png"], [])] == [
        ("png",),
        (),
        ("svg",),
        ("png", "pdf"),
        (),
    ]


PROBE = """
import hashlib, sys
import numpy as np
from scenarios.plots.comparisons import ComparisonRow, figure_comparison
from scenarios.plots.drawing import figure_png
import scenarios.plots.signals, scenarios.plots.estimates, scenarios.plots.estimates, scenarios.plots.estimates, scenarios.plots.signals
png = figure_png(figure_comparison([ComparisonRow("CL_alpha", 2.9, 2.8, 0.1, 9.0, 0.1)], "One"))
print("matplotlib.pyplot" in sys.modules, hashlib.sha256(png).hexdigest())
"""  # noqa: E501


@pytest.mark.long
def test_pyplot_stays_out_and_a_fresh_process_draws_the_same() -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7", "MPLBACKEND": "svg"}
    run = subprocess.run(
        [sys.executable, "-c", PROBE],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    here = figure_png(
        figure_comparison([ComparisonRow("CL_alpha", 2.9, 2.8, 0.1, 9.0, 0.1)], "One")
    )
    assert run.stdout.split() == ["False", hashlib.sha256(here).hexdigest()]
