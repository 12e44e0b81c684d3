"""Symbols, units and numbers as figures write them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser

from scenarios.plots.display import (
    POUNDS_PER_SQUARE_FOOT,
    DisplayUnit,
    axis_label,
    display_unit,
    scaled_unit,
    signed,
    symbol,
)
from scenarios.plots.estimates import figure_innovations, figure_parameter_histories
from tests.unit.scenarios.plots.conftest import Study


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("alpha", r"$\alpha$"),
        ("CL_alpha", r"$C_{L\alpha}$"),
        ("Cm_de", r"$C_{m\delta e}$"),
        ("CL_eta1", r"$C_{L\eta 1}$"),
        ("Cm_etadot12", r"$C_{m\dot{\eta} 12}$"),
        ("Ceta2_eta1", r"$C^{\eta 2}_{\eta 1}$"),
        ("M_delta", r"$M_{\delta}$"),
        ("L_0", "$L_{0}$"),
        ("bias_alpha", r"bias of $\alpha$"),
        ("input-delay.delay", "input-delay.delay"),
        ("CL_what", "CL_what"),
        ("CD_alpha2", r"$C_{D\alpha^2}$"),
        ("Cm_elevator", r"$C_{m\delta e}$"),
        ("CX_alpha_elevator", r"$C_{X\alpha\,\delta e}$"),
        ("CY_abs_beta", r"$C_{Y|\beta|}$"),
        ("Cl_beta_abs_beta", r"$C_{l\beta\,|\beta|}$"),
        ("Cn_alpha_left_elevon", "Cn_alpha_left_elevon"),
        ("CL_alpha_above_0p2", "CL_alpha_above_0p2"),
        ("Cm_alpha_", "Cm_alpha_"),
        ("a$b", r"a\$b"),
    ],
)
def test_symbol(name: str, expected: str) -> None:
    assert symbol(name) == expected


@pytest.mark.long
@given(st.text(alphabet="CLmeta_0123456789dotqx$.:-", min_size=1, max_size=14))
def test_every_symbol_can_be_set(name: str) -> None:
    MathTextParser("agg").parse(symbol(name))


def test_angles_are_shown_in_degrees_and_derivatives_are_not() -> None:
    assert display_unit("rad/s") == DisplayUnit("deg/s", 180.0 / math.pi)
    assert display_unit("1/rad") == DisplayUnit("1/rad")
    assert display_unit("kg m2").text == "kg m²"
    assert axis_label("CL_eta1", display_unit("1")).endswith("(–)")
    assert display_unit("in").factor == 1.0


def test_pound_per_square_foot() -> None:
    assert 4.88243 * POUNDS_PER_SQUARE_FOOT.factor == pytest.approx(1.0, rel=1e-6)


@given(st.floats(1e-25, 1e25))
def test_scaled_unit_keeps_the_value_and_leaves_few_digits(size: float) -> None:
    unit = scaled_unit(DisplayUnit("m"), size)
    shown = size * unit.factor
    assert 0.02 <= shown < 2e4
    power = round(math.log10(unit.factor))
    assert unit.text == (
        "m"
        if power == 0
        else f"10{str(-power).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))} m"
    )


def test_signed() -> None:
    assert (signed(-12.34, ".1f"), signed(3.0, ".0f")) == ("−12.3", "+3")


def test_inputs_of_a_measured_airspeed_have_words() -> None:
    assert axis_label("airspeed_change", display_unit("m/s")) == "$V - V_0$ (m/s)"
    assert axis_label("lift", display_unit("1")) == "added lift (–)"


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
