"""The figure of a whole flight: a band that loses no peak, few points, holes at pauses, a number
for each maneuver.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ident.maneuver_detection import DetectedManeuver
from scenarios.plots.drawing import plot_data
from scenarios.plots.maneuvers import ENVELOPE_BINS, envelope, figure_flight
from sim.record import Channel, Record


def test_a_band_keeps_every_peak_in_its_place() -> None:
    rng = np.random.default_rng(0)
    times = np.arange(200_000) * 0.01
    values = rng.standard_normal(times.size)
    values[[777, 123_456]] = [50.0, -60.0]
    values[5000:5100] = np.nan
    middle, low, high = envelope(times, values)
    assert middle.size == low.size == high.size == ENVELOPE_BINS
    assert (high.max(), low.min()) == (50.0, -60.0)
    assert middle[np.argmax(high)] == pytest.approx(7.77, abs=2.0)
    assert np.all(low[1:] <= high[:-1]) and np.all(low[:-1] <= high[1:]), "neighbours touch"


def test_few_samples_are_drawn_as_they_are() -> None:
    times, values = np.arange(10.0), np.arange(10.0) ** 2
    assert all(
        np.array_equal(got, wanted)
        for got, wanted in zip(envelope(times, values), (times, values, values), strict=True)
    )


def drawn(pause: float) -> Figure:
    """Two parts of 100 s with a pause between them, and a maneuver on either side."""
    times = np.r_[np.arange(0.0, 100.0, 0.1), np.arange(0.0, 100.0, 0.1) + 100.0 + pause]
    outputs = tuple(
        Channel.of(name, unit, np.sin(times))
        for name, unit in (("elevator", "rad"), ("phi", "rad"), ("nz", "g"))
    )
    found = [
        DetectedManeuver(20.0, 30.0, "pitch", "doublet", "elevator", 0.1),
        DetectedManeuver(140.0 + pause, 160.0 + pause, "roll", "turn", "phi", 0.5),
        DetectedManeuver(120.0 + pause, 130.0 + pause, "all", "trim", "", 0.0),
    ]
    numbered = [SimpleNamespace(number=k, found=each) for k, each in enumerate(found, start=1)]
    return figure_flight(
        SimpleNamespace(record=Record(times, (), outputs), maneuvers=numbered, simulated=False),
        "flight.csv",
    )


def test_a_short_pause_is_a_hole_in_the_band() -> None:
    elevator, nz, phi = drawn(20.0).axes
    assert [[text.get_text() for text in panel.texts] for panel in (elevator, nz, phi)] == [
        ["1"],
        [],
        ["2"],
    ]
    assert "elevator" in elevator.get_ylabel() and "deg" in phi.get_ylabel()
    (line,) = [each for each in elevator.lines if np.size(each.get_xdata()) > 2]
    times, values = map(np.asarray, line.get_data())
    assert np.flatnonzero(np.isnan(values)).size == 1, "a hole at the pause"
    assert np.all(np.diff(times) >= 0.0)


def test_a_flight_zooms_though_its_maneuvers_are_numbered() -> None:
    for pause in (20.0, 5000.0):
        data = plot_data(drawn(pause))
        assert data is not None
        spans = {curve.label for panel in data.panels for curve in panel.curves} - {""}
        assert spans == {"pitch maneuver", "roll maneuver"}


def test_a_long_pause_is_cut_out_and_each_part_has_its_panels() -> None:
    panels = drawn(5000.0).axes
    assert [[text.get_text() for text in panel.texts] for panel in panels] == [
        ["1"],
        [],
        [],
        [],
        [],
        ["2"],
    ]
    spans = [panel.get_xlim() for panel in panels[:2]]
    assert spans == [pytest.approx((0.0, 99.9)), pytest.approx((5100.0, 5199.9))]
    assert panels[0].get_ylim() == panels[1].get_ylim() and panels[1].get_ylabel() == ""
    first, second = (panel.get_position().width for panel in panels[:2])
    assert first == pytest.approx(second, rel=0.01)
