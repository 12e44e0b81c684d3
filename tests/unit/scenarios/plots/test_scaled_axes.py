"""Axes of values far from one: the power of ten stands in the unit, nowhere above the numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from scenarios.plots.estimates import figure_innovations, figure_parameter_histories
from tests.unit.scenarios.plots.conftest import Study


def powers_above(figure: Figure) -> list[str]:
    """What stands above the numbers of any axis."""
    figure.canvas.draw()
    return [panel.yaxis.get_offset_text().get_text() for panel in figure.axes]


def test_a_mean_near_nothing_is_shown_at_the_size_of_its_band(rigid: Study) -> None:
    history = rigid.history
    row = history.names.index("CL_q")
    mean, std = history.mean.copy(), history.std
    mean[row] = 1e-7
    figure = figure_parameter_histories(replace(history, mean=mean), ("CL_q",), ("1/rad",))
    assert 0.02 < 2.0 * float(std[row, -1]) < 2e4
    assert figure.axes[0].get_title(loc="left").endswith("(1/rad)")
    assert figure.axes[0].get_ylim()[1] > 2.0 * std[row, -1]
    assert set(powers_above(figure)) == {""}


def test_small_innovations_have_their_power_in_the_unit(rigid: Study) -> None:
    history = rigid.history
    small = replace(
        history, innovation=1e-4 * history.innovation, innovation_std=1e-4 * history.innovation_std
    )
    figure = figure_innovations(small, rigid.estimate.output_names, ("rad", "rad/s"))
    assert all("(10⁻" in panel.get_ylabel() for panel in figure.axes[::2])
    assert set(powers_above(figure)) == {""}
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "innovation"]
    valid = history.valid[0]
    # 1e-4 of some tenths of a degree: shown in millionths of one.
    assert np.asarray(line.get_ydata()) == pytest.approx(
        1e6 * np.degrees(small.innovation[0, valid])
    )
