"""Figures of a page: small, the same for the same figure, nothing off by more than can be seen."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path as FilePath
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.drawing import (
    CELLS_PER_DOT,
    OUTLINE_TOLERANCE,
    PRINTED_HEIGHT_SHARE,
    TALLEST_ASPECT,
    description,
    draw_for_page,
    page_svg,
)
from scenarios.plots.style import (
    MEASURED,
    finish,
    hide_bold_title,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)
from scenarios.report.figure_formats import CAPTIONS, caption_of

MOST = 3_000_000  # bytes of a page


def noisy(count: int, records: int) -> list[Figure]:
    """One figure a record: three panels of measured noise about two responses, as a fit has
    them.
    """
    generator, figures = np.random.default_rng(1), []
    for _ in range(records):
        sheet = make_sheet([1.0] * 3)
        time = np.arange(count) / 100.0
        for panel in sheet.panels:
            smooth = np.sin(time)
            panel.plot(
                time, smooth + 0.1 * generator.standard_normal(count), label="measured", **MEASURED
            )
            panel.plot(time, smooth, label="estimated", **method_style(0))
            panel.plot(
                time,
                smooth + 0.1 * generator.standard_normal(count),
                label="residual",
                **method_style(1),
            )
            panel.fill_between(
                time, smooth - 0.2, smooth + 0.2 * generator.random(count), alpha=0.3, label="±2σ"
            )
            y_label(panel, "$\\alpha$ (deg)")
        time_axis(sheet.panels[-1])
        figures.append(finish(sheet, "records <of> a & b"))
    return figures


@pytest.mark.slow
def test_four_long_records_make_a_page_below_its_limit() -> None:
    drawn = [page_svg(figure, f"fit_{number}") for number, figure in enumerate(noisy(8000, 4))]
    assert 100_000 < sum(map(len, drawn)) < MOST
    root = ElementTree.fromstring(drawn[0])
    assert root.attrib["role"] == "img" and root.attrib["aria-label"].startswith(
        "records <of> a & b. Panels: alpha (deg) against time (s)."
    )
    names = re.findall(r'id="([^"]*)"', "".join(drawn))
    used = set(re.findall(r'(?:url\(|href=")#([^)"]*)', "".join(drawn)))
    assert len(names) == len(set(names)) and used == set(names)


def test_same_figure_same_text_and_no_style_of_its_own() -> None:
    (figure,), (again,) = noisy(50, 1), noisy(50, 1)
    text = page_svg(figure, "fit")
    assert text == page_svg(again, "fit") == page_svg(figure, "fit")
    assert " style=" not in text and "<style" not in text and "metadata" not in text
    assert "Shown: measured, estimated, residual, ±2σ" in description(figure)


def points_of(data: str) -> np.ndarray:
    """Vertices of absolute path data: ``(n, 2)``."""
    return np.array([pair.split() for pair in re.findall(r"-?[\d.]+ -?[\d.]+", data)], float)


def only_line(make: Callable[[Axes], object]) -> list[str]:
    """Paths that an empty panel of 400 by 60 points does not have without what ``make`` draws."""
    found = []
    for draw in (lambda panel: None, make):
        figure = Figure(figsize=(400 / 72, 60 / 72))
        panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        panel.set_axis_off()
        panel.set(xlim=(0.0, 400.0), ylim=(60.0, 0.0))
        draw(panel)
        found.append(re.findall(r' d="([^"]*)"', page_svg(figure, "one")))
    assert found[1][: len(found[0])] == found[0]
    return found[1][len(found[0]) :]


@pytest.mark.parametrize("count", [40, 5000])
def test_lines_keep_within_their_tolerance(count: int) -> None:
    x = np.linspace(0.0, 400.0, count)
    y = 30.0 + 25.0 * np.sin(x / 30.0) * np.exp(-x / 300.0)
    (data,) = only_line(lambda panel: panel.plot(x, y))
    found = points_of(data)
    assert len(found) <= count and (count < 100 or len(found) < count / 5)
    off = np.abs(np.interp(x, found[:, 0], found[:, 1]) - y)
    assert off.max() < OUTLINE_TOLERANCE + 0.1  # and a tenth of a point by rounding
    assert found[[0, -1]] == pytest.approx(np.array([[x[0], y[0]], [x[-1], y[-1]]]), abs=0.3)


def test_gaps_stay_gaps_and_areas_are_closed_and_simplified() -> None:
    x = np.linspace(0.0, 400.0, 2000)
    y = np.where((x > 100) & (x < 120), np.nan, 30.0 + 10.0 * np.sin(x / 20.0))
    (data,) = only_line(lambda panel: panel.plot(x, y))
    assert data.count("M") == 2
    low = 30.0 + 10.0 * np.sin(x / 20.0)
    area = only_line(lambda panel: panel.fill_between(x, low, low + 9.0, linewidth=0))[0]
    assert area.endswith("z") and area.count("M") == 1 and area.count("L") < 800
    found = points_of(area)
    assert np.isclose(found[:, 1].max(), 49.0, atol=0.4) and np.isclose(
        found[:, 1].min(), 20.0, atol=0.4
    )


@pytest.mark.long
def test_dots_that_cover_each_other_are_one_and_none_is_lost() -> None:
    generator = np.random.default_rng(2)
    points = np.column_stack(
        [generator.uniform(0.0, 400.0, 20_000), generator.uniform(0.0, 60.0, 20_000)]
    )
    points[7] = np.nan
    (data,) = only_line(lambda panel: panel.plot(*points.T, **MEASURED))
    found = points_of(data.replace("h0", " "))
    size = 0.5 * MEASURED["markersize"]  # of matplotlib's "."
    assert len(found) < 20_000
    sound = np.delete(points, 7, axis=0)[::37]
    nearest = np.sqrt(((sound[:, None, :] - found[None]) ** 2).sum(axis=2)).min(axis=1)
    assert nearest.max() < np.sqrt(2.0) * size / CELLS_PER_DOT + 0.1


def test_captions_know_records_and_methods() -> None:
    assert (
        caption_of("fit") == CAPTIONS["fit"]
        and caption_of("fit_2") == f"{CAPTIONS['fit']} (record 2)"
    )
    assert caption_of("fit_other") == CAPTIONS["fit_other"] and caption_of(
        "innovations_ukf-two"
    ).endswith("(ukf-two)")
    labels = {"one-pass": "extended Kalman filter"}
    assert caption_of("innovations_one-pass", methods=labels).endswith("(extended Kalman filter)")
    assert caption_of("some_thing") == "Some thing"


def one() -> Figure:
    return noisy(20, 1)[0]


@pytest.mark.long
def test_figures_of_a_page_are_drawn_once_and_in_every_format(tmp_path: FilePath) -> None:
    calls: list[str] = []

    def noted(stem: str) -> Figure:
        calls.append(stem)
        return one()

    stems = ["record", "fit", "errors"]
    named = [(stem, partial(noted, stem)) for stem in stems]
    drawn = draw_for_page(named, tmp_path, ("png",))
    assert calls == stems == [each.stem for each in drawn]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(f"{s}.png" for s in stems)
    assert drawn[0].svg == page_svg(one(), "record")
    # A title that the page has already is cut off, and its words stay in the description.
    again = one()
    cut = hide_bold_title(again)
    assert cut > 0.0 and drawn[1].svg == page_svg(again, "fit", cut)
    assert [each.svg.count(">records") for each in drawn] == [1, 0, 0]
    assert all('aria-label="records' in each.svg for each in drawn)


def test_numbers_that_are_read_keep_their_digits() -> None:
    """Places may be rounded to two decimals, ticks and values may not."""
    figure = Figure(figsize=(4.0, 3.0))
    panel = figure.add_subplot()
    panel.plot([0.0, 1.0], [0.0, 0.004])
    panel.set_yticks([0.0015, 0.0035], ["0.0015", "0.0035"])
    panel.text(0.5, 0.002, "2.925 ± 0.004")
    svg = page_svg(figure, "digits")
    assert all(f">{text}<" in svg for text in ("2.925 ± 0.004", "0.0015", "0.0035"))
    assert not re.search(r'(x|y|d)="[^"]*\d\.\d{3}', svg)


def test_a_tall_live_figure_is_printed_lower_and_kept_as_it_was(tmp_path: FilePath) -> None:
    figure = one()
    width, height = 7.0, 9.0
    figure.set_size_inches(width, height)
    (drawn,) = draw_for_page([("fit", lambda: figure)], tmp_path, ())
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawn.svg)
    assert found is not None and drawn.plot is not None
    assert float(found[2]) / float(found[1]) == pytest.approx(TALLEST_ASPECT, rel=1e-3)
    assert float(found[1]) == pytest.approx(72.0 * width)
    assert tuple(figure.get_size_inches()) == (width, height)


def test_many_panels_are_printed_smaller_and_keep_most_of_their_height(tmp_path: FilePath) -> None:
    figure = one()
    figure.set_size_inches(7.0, 40.0)
    (drawn,) = draw_for_page([("fit", lambda: figure)], tmp_path, ())
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawn.svg)
    assert found is not None
    assert PRINTED_HEIGHT_SHARE >= 0.8  # labels lie on each other in panels of half the height
    assert float(found[2]) == pytest.approx(72.0 * PRINTED_HEIGHT_SHARE * 40.0, rel=1e-3)
    assert float(found[2]) / float(found[1]) == pytest.approx(TALLEST_ASPECT, rel=1e-3)
