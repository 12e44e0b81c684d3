"""Figures of a page: small, the same for the same figure, nothing off by more than can be seen."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path as FilePath
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.transforms import IdentityTransform

from scenarios.plots.drawing import description, drawn_for_page, leave_for_page, page_svg
from scenarios.plots.formats import CAPTIONS, caption_of, gathered
from scenarios.plots.style import MEASURED, finish, make_sheet, method_style, time_axis, y_label
from scenarios.plots.svg_renderer import DOT, TOLERANCE, dots_data, path_data
from tests.forks import remembered_forks

MOST = 3_000_000  # bytes of a page
_TOKEN = re.compile(r"([a-zA-Z])|(-?(?:\d+\.?\d*|\.\d+))")


def points_of(data: str) -> np.ndarray:
    """Vertices of path data with moves, lines and ends, a second reading: ``(n, 2)`` absolute."""
    at, begun, letter = np.zeros(2), np.zeros(2), ""
    found: list[np.ndarray] = []
    numbers: list[float] = []
    for command, number in _TOKEN.findall(data):
        if command:
            letter, numbers = command, []
            if command == "z":
                at = begun
            continue
        numbers.append(float(number))
        if letter == "h":
            at, numbers = at + [numbers[0], 0.0], []
        elif len(numbers) == 2:
            at = np.array(numbers) if letter == "M" else at + numbers
            begun = at if letter in "mM" else begun
            found.append(at)
            letter, numbers = {"m": "l", "M": "L"}.get(letter, letter), []
    return np.array(found)


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
    assert len(names) == len(set(names)) and set(
        re.findall(r"url\(#([^)]*)\)", "".join(drawn))
    ) == set(names)


def test_same_figure_same_text_and_no_style_of_its_own() -> None:
    (figure,), (again,) = noisy(50, 1), noisy(50, 1)
    text = page_svg(figure, "fit")
    assert text == page_svg(again, "fit") == page_svg(figure, "fit")
    assert " style=" not in text and "<style" not in text and "metadata" not in text
    assert "Shown: measured, estimated, residual, ±2σ" in description(figure)


@pytest.mark.parametrize("count", [40, 5000])
def test_lines_keep_within_their_tolerance(count: int) -> None:
    x = np.linspace(0.0, 450.0, count)
    y = 50.0 + 40.0 * np.sin(x / 30.0) * np.exp(-x / 300.0)
    found = points_of(path_data(Path(np.column_stack([x, y])), IdentityTransform(), filled=False))
    assert len(found) <= count and (count < 100 or len(found) < count / 5)
    off = np.abs(np.interp(x, found[:, 0], found[:, 1]) - y)
    assert off.max() < TOLERANCE + 0.1  # and a tenth of a point by rounding
    assert found[[0, -1]] == pytest.approx(np.array([[x[0], y[0]], [x[-1], y[-1]]]), abs=0.3)


def test_gaps_stay_gaps_and_areas_are_closed() -> None:
    x = np.arange(300.0)
    y = np.where((x > 100) & (x < 120), np.nan, 10.0 * np.sin(x))
    line = path_data(Path(np.column_stack([x, y])), IdentityTransform(), filled=False)
    assert line.count("m") == 2
    outline = np.column_stack([np.r_[x, x[::-1]], np.r_[np.cos(x), 5.0 + np.cos(x)]])
    area = path_data(Path(outline, closed=True), IdentityTransform(), filled=True)
    assert area.endswith("z") and area.count("m") == 1
    assert path_data(Path(np.full((3, 2), np.nan)), IdentityTransform(), filled=False) == ""


def test_dots_that_cover_each_other_are_one_and_none_is_lost() -> None:
    generator = np.random.default_rng(2)
    points = np.column_stack(
        [generator.uniform(0.0, 400.0, 20_000), generator.uniform(0.0, 60.0, 20_000)]
    )
    points[7] = np.nan
    size = 1.5
    found = points_of(dots_data(points, size))
    assert len(found) < 20_000 and dots_data(points[7:8], size) == ""
    sound = np.delete(points, 7, axis=0)[::37]
    nearest = np.sqrt(((sound[:, None, :] - found[None]) ** 2).sum(axis=2)).min(axis=1)
    assert nearest.max() < np.sqrt(2.0) * size / DOT + 0.1


def test_captions_know_records_and_methods() -> None:
    assert (
        caption_of("fit") == CAPTIONS["fit"]
        and caption_of("fit_2") == f"{CAPTIONS['fit']} (record 2)"
    )
    assert caption_of("fit_other") == CAPTIONS["fit_other"] and caption_of(
        "innovations_ukf-two"
    ).endswith("(ukf-two)")
    assert caption_of("some_thing") == "Some thing"


def one() -> Figure:
    return noisy(20, 1)[0]


def test_figures_are_the_same_with_a_fork_without_one_and_when_it_fails(
    tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = subprocess.Popen([sys.executable, "-c", "raise SystemExit(1)"])
    found = []
    for name, count, fork in (("alone", 2, os.fork), ("failed", 1, lambda: gone.pid)):
        monkeypatch.setattr("threading.active_count", lambda count=count: count)
        monkeypatch.setattr(os, "fork", fork)
        (tmp_path / name).mkdir()
        found.append(
            drawn_for_page(
                [(stem, one) for stem in ("record", "fit", "errors")], tmp_path / name, ()
            )
        )
        assert list((tmp_path / name).iterdir()) == []
    gone.returncode = 1  # it was waited for

    def full() -> int:
        raise BlockingIOError

    monkeypatch.setattr("threading.active_count", lambda: 1)
    monkeypatch.setattr(os, "fork", full)
    assert (
        drawn_for_page(
            [(stem, one) for stem in ("record", "fit", "errors")], tmp_path / "alone", ()
        )
        == found[0]
    )
    assert found[0] == found[1] and [each.stem for each in found[0]] == ["record", "fit", "errors"]
    leave_for_page([("fit", one)], tmp_path, ())
    assert gathered(tmp_path) == {"fit": found[0][1].svg}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
def test_a_fork_is_waited_for_and_leaves_nothing_where_drawing_fails(
    tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> Figure:
        raise ValueError("broken")

    helpers = remembered_forks(monkeypatch)
    monkeypatch.setattr("threading.active_count", lambda: 1)
    with pytest.raises(ValueError, match="broken"):
        drawn_for_page([("record", broken), ("fit", one)], tmp_path, ())
    with pytest.raises(ChildProcessError):
        os.waitpid(helpers[0], os.WNOHANG)
    for path in tmp_path.iterdir():
        path.unlink()
    parent = os.getpid()

    def broken_there() -> Figure:
        if os.getpid() != parent:
            raise ValueError("broken")
        return one()

    drawn = drawn_for_page(
        [("record", one), ("fit", one), ("errors", one), ("states", broken_there)], tmp_path, ()
    )
    assert [each.stem for each in drawn] == ["record", "fit", "errors", "states"] and list(
        tmp_path.iterdir()
    ) == []
