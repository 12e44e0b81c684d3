"""Figures of frequency responses keep the laws of all figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

import flightid as fid
from scenarios.plots.flying_qualities import (
    figure_bandwidth,
    figure_margins,
    figure_mismatch,
    figure_response,
)
from scenarios.plots.low_order import figure_linear, figure_open_margins
from sim.errors import DeclarationError
from tests.figure_laws import broken_laws, words

STEP = 0.02


@pytest.fixture(scope="module")
def flown() -> dict[str, np.ndarray]:
    """A stick with feedback of the pitch rate, a sweep that is added to it, a second input."""
    rng = np.random.default_rng(3)
    count = 10000
    top, bottom, _ = signal.cont2discrete(([6.0, 7.2], [1.0, 3.2, 16.0]), STEP, "zoh")
    top = np.concatenate([np.zeros(4), np.ravel(top)[1:]])
    bottom = np.concatenate([bottom, np.zeros(3)])
    sweep, other = (
        signal.lfilter(*signal.butter(2, 0.3), rng.standard_normal(count)) for _ in "ab"
    )
    noise = 0.05 * rng.standard_normal(count)
    closed = np.polyadd(bottom, 0.3 * top)
    q = signal.lfilter(top, closed, sweep) + signal.lfilter(bottom, closed, noise)
    time = STEP * np.arange(count)
    return {"time": time, "stick": sweep - 0.3 * q, "sweep": sweep, "other": other, "q": q}


@pytest.mark.parametrize("case", ["one", "two", "joint"])
def test_laws(flown: dict[str, np.ndarray], case: str) -> None:
    inputs = ["stick", "other"] if case == "two" else ["stick"]
    reference = ["sweep"] if case == "joint" else []
    details = fid.frequency_response(
        flown,
        inputs,
        "q",
        reference=reference,
        band=(0.1, 5.0),
        fit="pitch" if case != "two" else (),
        bandwidth="rate",
        margins="minus" if case != "two" else None,
    ).details
    drawn = [figure_response(details)]
    drawn += [figure_bandwidth(details)]
    drawn += [figure_margins(details)] if case != "two" else []
    drawn += [figure_mismatch(details)] if case != "two" else [figure_response(details, 0, 1)]
    for figure in drawn:
        assert not broken_laws(figure)
        assert figure.axes[-1].get_xlabel() == "frequency (Hz)"
    for panel in drawn[0].axes[:2]:
        bottom, top = panel.get_ylim()
        for line in panel.lines:
            values = np.asarray(line.get_ydata(), float)
            assert bottom < values.min() and values.max() < top, "a curve leaves its panel"
    assert ("partial coherence" in words(drawn[0])) == (case == "two")
    assert ("direct" in words(drawn[0])) == (case == "joint")
    assert "phase bandwidth" in words(drawn[1]) and "-180 deg" in words(drawn[1])
    if case == "two":
        with pytest.raises(DeclarationError, match="no margins to draw"):
            figure_margins(details)
        with pytest.raises(DeclarationError, match="no transfer function is fitted"):
            figure_mismatch(details)


def test_flown_and_linear_are_drawn_in_degrees_and_the_misfit_over_the_stick() -> None:
    time, names, units = np.linspace(0.0, 1.0, 5), ("alpha", "q", "nz"), ("rad", "rad/s", "g")
    linear = np.outer([0.01, 0.02, 0.3], time)
    sticks, curves = (
        (0.1, 1.0),
        {
            "as flown": (0.5, 0.01),
            "no break-out": (0.01, 0.05),
            "limits alone": (0.0, float("nan")),
        },
    )
    figure = figure_linear(time, 1.1 * linear, linear, names, units, sticks, curves, "title")
    alpha, _, nz, error, misfit = figure.axes
    np.testing.assert_allclose(np.asarray(alpha.lines[0].get_ydata()), np.degrees(1.1 * linear[0]))
    np.testing.assert_allclose(np.asarray(nz.lines[1].get_ydata()), linear[2])
    np.testing.assert_allclose(
        np.asarray(error.lines[0].get_ydata()), np.degrees(0.1 * linear[1]), atol=1e-12
    )
    drawn = {
        str(line.get_label()): np.asarray(line.get_ydata(), dtype=float) for line in misfit.lines
    }
    assert misfit.get_xscale() == misfit.get_yscale() == "log"
    np.testing.assert_allclose(drawn["as flown"], curves["as flown"])
    assert 0.0 < drawn["limits alone"][0] < 1e-15 and np.isnan(drawn["limits alone"][1]), (
        "nothing is drawn at the foot, a departure not at all"
    )


def test_margins_are_drawn_with_the_line_between_the_signs() -> None:
    clouds = [
        ("airframes alone", np.array([30.0, 40.0]), np.array([35.0, 38.0])),
        ("everything open", np.array([31.0]), np.array([29.0])),
    ]
    declared = [("F and S, declared", 37.6, 33.1), ("D and S, declared", 37.6, 38.8)]
    figure = figure_open_margins(
        clouds, declared, [("pitch damping", 4.0), ("computing delay", -3.0)], "title"
    )
    scatter, bars = figure.axes
    drawn = {
        str(line.get_label()): (
            np.asarray(line.get_xdata(), dtype=float),
            np.asarray(line.get_ydata(), dtype=float),
        )
        for line in scatter.lines
    }
    np.testing.assert_allclose(drawn["airframes alone"], (clouds[0][1], clouds[0][2]))
    np.testing.assert_allclose(drawn["D and S, declared"], ([37.6], [38.8]))
    equal = drawn["equal: above it the paper's sign"]
    np.testing.assert_allclose(equal[0], equal[1])
    assert scatter.get_xlim() == scatter.get_ylim()
    ends = [
        np.asarray(bar.get_path().get_extents(bar.get_patch_transform()).get_points())[:, 0]
        for bar in bars.patches
    ]
    np.testing.assert_allclose(np.sum(ends, axis=1), [4.0, -3.0])
    assert len(figure_open_margins(clouds, declared, [], "title").axes) == 1, (
        "no bars where no line was drawn"
    )
