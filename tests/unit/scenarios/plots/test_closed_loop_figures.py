"""Figures of the closed loop draw what they are given: degrees, misfits down to nothing, points on
both sides of the line.
"""

from __future__ import annotations

import numpy as np

from scenarios.plots.low_order import figure_linear, figure_open_margins


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
