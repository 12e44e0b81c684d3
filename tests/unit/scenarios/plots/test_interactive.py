"""Data of figures that zoom: what is in the figure, to the digits that a page shows, and nothing of
a figure that a page could not draw.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html import unescape

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.drawing import MOST_CURVE_SAMPLES, figure_document, plot_data, words
from scenarios.plots.style import MEASURED, finish, make_sheet, method_style, time_axis, y_label
from scenarios.report.document import Figure as Drawing
from scenarios.report.document import Page, Reproduction, section
from scenarios.report.html import page_content, page_html, page_of
from scenarios.report.plot_data import (
    BAND,
    HELD,
    LINE,
    POINTS,
    Curve,
    Panel,
    PlotData,
    as_kept,
    plot_content,
    plot_of,
)
from sim.errors import ModelError

TIME = np.linspace(0.0, 8.0, 401)


def history() -> Figure:
    """Two panels over one time axis: points, a line, a span of noise, an area, a line across."""
    sheet = make_sheet([1.4, 1.0])
    above, below = sheet.panels
    above.plot(TIME, np.sin(TIME) + 0.01, label="measured", **MEASURED)
    above.plot(TIME, np.sin(TIME), label="estimated", **method_style(1))
    above.fill_between(TIME, np.sin(TIME) - 0.2, np.sin(TIME) + 0.3, color="#56B4E9", label="±2σ")
    y_label(above, r"$\alpha$ (deg)")
    below.axhspan(-0.02, 0.02, color="#56B4E9", label="noise")
    below.axhline(0.005, color="#000000")
    below.plot(TIME, np.full(TIME.shape, 0.01), linestyle="none", marker=".", color="#0072B2")
    below.set_ylim(-0.05, 0.05)
    time_axis(below)
    return finish(sheet, "history")


def test_curves_of_a_figure_are_those_that_were_drawn() -> None:
    data = plot_data(history())
    assert data is not None
    above, below = data.panels
    assert (above.y_label, below.x_label) == ("α (deg)", "time (s)")
    assert above.group == below.group and (above.row, below.row) == (0, 1)
    curves = {curve.label: curve for curve in above.curves}
    assert [curves[name].kind for name in ("measured", "estimated", "±2σ")] == [POINTS, LINE, BAND]
    for name, offset in (("measured", 0.01), ("estimated", 0.0), ("±2σ", -0.2)):
        np.testing.assert_allclose(curves[name].x, TIME, atol=1e-9)
        np.testing.assert_allclose(curves[name].y, np.sin(TIME) + offset, atol=2e-5)
    top = curves["±2σ"].top
    assert top is not None
    np.testing.assert_allclose(top, np.sin(TIME) + 0.3, atol=2e-5)
    assert curves["estimated"].dash and not curves["measured"].dash
    noise, across, _ = below.curves
    assert (noise.kind, noise.y.tolist()) == (BAND, [-0.02, -0.02])
    assert across.x.tolist() == list(below.x_range) and across.y.tolist() == [0.005, 0.005]
    assert below.y_range == (-0.05, 0.05)


def bars(panel: Axes) -> None:
    panel.barh([0.0, 1.0], [1.0, 2.0])


def error_bars(panel: Axes) -> None:
    panel.errorbar([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], yerr=0.1)


def named_points(panel: Axes) -> None:
    panel.plot(TIME, TIME)
    panel.text(1.0, 1.0, "phugoid")


def crosses(panel: Axes) -> None:
    panel.plot(TIME, TIME, marker="x", linestyle="none")


def nothing(panel: Axes) -> None:
    panel.axhline(0.0)


@pytest.mark.parametrize("draw", [bars, error_bars, named_points, crosses, nothing])
def test_a_figure_of_anything_else_stays_as_it_is(draw: Callable[[Axes], None]) -> None:
    sheet = make_sheet([1.0])
    draw(sheet.panels[0])
    assert plot_data(finish(sheet)) is None


@settings(max_examples=20)
@given(
    place=st.floats(-1e5, 1e5),
    span=st.floats(1e-2, 1e4),  # s: shorter records there are none
    share=st.floats(0.0, 1.0),
)
def test_an_upright_line_has_two_ends_less_than_a_pixel_apart(
    place: float, span: float, share: float
) -> None:
    figure = Figure()
    panel = figure.subplots()
    panel.plot(place + span * np.linspace(0.0, 1.0, 9), np.arange(9.0))
    panel.set_xlim(place, place + span)
    panel.axvline(place + share * span, color="#D55E00", label="mode")
    data = plot_data(figure)
    assert data is not None
    (line,) = (each for each in data.panels[0].curves if each.label == "mode")
    kept = plot_of(plot_content(data)).panels[0].curves[-1]
    for curve in (line, kept):
        first, second = curve.x.tolist()
        # 700 px is as wide as a panel gets.
        assert 0.0 < second - first < span / 700.0
        assert curve.y.tolist() == pytest.approx(sorted(panel.get_ylim()), rel=1e-3, abs=1e-3)


def test_a_figure_alone_holds_its_data_and_asks_nobody() -> None:
    data = plot_data(history())
    assert data is not None
    text = figure_document(history(), 'a "history" <of> & two')
    (kept,) = re.findall(r' data-plot="([^"]*)"', text)
    assert json.loads(unescape(kept)) == plot_content(data)
    assert 'aria-label="a &quot;history&quot; &lt;of&gt; &amp; two"' in text
    assert "default-src 'none'" in text and not re.search(r'(?:src|href)="(?!#)', text)
    bars = Figure()
    bars.subplots().bar([0.0, 1.0], [1.0, 2.0])
    alone = figure_document(bars, "bars")
    assert "data-plot=" not in alone.partition("<script")[0] and "<svg" in alone


def test_a_held_input_stays_held() -> None:
    sheet = make_sheet([1.0])
    sheet.panels[0].plot(TIME, np.sign(np.sin(TIME)), drawstyle="steps-post")
    data = plot_data(finish(sheet))
    assert data is not None and [curve.kind for curve in data.panels[0].curves] == [HELD]


def test_a_long_curve_keeps_its_peaks() -> None:
    sheet, values = make_sheet([1.0]), np.random.default_rng(1).standard_normal(50_000)
    values[12_345], values[40_000] = 50.0, -60.0
    sheet.panels[0].plot(np.arange(50_000.0), values)
    data = plot_data(finish(sheet))
    assert data is not None
    (curve,) = data.panels[0].curves
    assert len(curve.x) <= MOST_CURVE_SAMPLES and np.all(np.diff(curve.x) > 0.0)
    assert (curve.y.max(), curve.y.min()) == (50.0, -60.0)


@given(arrays(float, st.integers(1, 40), elements=st.floats(-1e9, 1e9) | st.just(float("nan"))))
def test_values_are_kept_to_16_bits_of_their_range_and_gaps_stay_gaps(y: np.ndarray) -> None:
    curve = Curve("a", LINE, "#0072b2", np.arange(float(len(y))), y)
    panel = Panel("time (s)", "q", "", 0, 0, 0, 1.0, (0.0, 1.0), (0.0, 1.0), (curve,))
    once = as_kept(PlotData((panel,)))
    kept = once.panels[0].curves[0]
    assert np.array_equal(np.isnan(kept.y), np.isnan(y))
    sound = ~np.isnan(y)
    if np.any(sound):
        reach = float(np.ptp(y[sound])) / 65534 + 1e-8 * float(np.abs(y[sound]).max())
        assert np.all(np.abs(kept.y[sound] - y[sound]) <= reach)
    assert plot_content(as_kept(once)) == plot_content(once)


@pytest.mark.parametrize(
    "harm",
    [
        {"colour": "red;}</style>"},
        {"kind": "script"},
        {"y": {"low": 0.0, "high": 1.0, "codes": "AAA"}},
        {"y": {"low": 0.0, "high": float("inf"), "codes": "AAAA"}},
        {"x": {"from": 0.0, "to": 1.0, "count": 10**9}},
        {"x": [2.0, 1.0]},
        {"label": 3},
    ],
)
def test_a_content_that_holds_anything_else_is_refused(harm: dict[str, object]) -> None:
    data = plot_data(history())
    assert data is not None
    content = json.loads(json.dumps(plot_content(data)))
    content["panels"][0]["curves"][0] |= harm
    with pytest.raises((KeyError, TypeError, ValueError, ModelError)):
        plot_of(content)


def test_a_page_made_again_has_the_same_bytes_and_scripts_only_where_a_figure_zooms() -> None:
    svg = '<svg viewBox="0 0 1 1" width="1" height="1" role="img" aria-label="A."></svg>'
    pages = [
        Page(
            *("t", "k", "v", "good", "s", (), ()),
            section("Figures", Drawing("figure-fit", svg, "The fit", plot)),
            Reproduction(("flightid run rigid",)),
        )
        for plot in (plot_data(history()), None)
    ]
    with_plot, without = map(page_html, pages)
    assert "uPlot" in with_plot and "data-plot=" in with_plot and "uPlot" not in without
    assert page_html(page_of(json.loads(json.dumps(page_content(pages[0]))))) == with_plot


def test_labels_have_letters_in_the_place_of_mathtext() -> None:
    assert words(r"elevator $\delta_e$ (deg)") == "elevator δe (deg)"
    assert words(r"$C_{m\alpha}$") == "Cmα"
    assert words(r"left_aileron $\delta_{a}$, flight_2.csv") == "left_aileron δa, flight_2.csv"
