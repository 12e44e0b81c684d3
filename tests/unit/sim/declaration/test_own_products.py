"""What the parameters of a user's own model multiply, against models whose equations are known."""

from __future__ import annotations

from typing import Any

import pytest

from sim.declaration import own_model
from sim.declaration.model import Model
from sim.declaration.user_equations import UserEquations


def spring(**ports: Any) -> Model:
    """A spring and a damper with a drag by the speed's square, and a constant push that multiplies
    nothing.
    """
    load = (lambda s: s.load) if ports else (lambda s: 0.0)
    return own_model(
        name="spring-mass",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m"},
        constants={"m": (2.0, "kg")},
        parameters={"k": (40.0, "N/m"), "c": (1.3, "N s2/m2"), "push": (0.5, "N")},
        flow=lambda s, p: {"a": (s.force + load(s) + p.push - p.c * s.v * s.v - p.k * s.x) / p.m},
        rates=lambda s, p: {"x": s.v, "v": s.a},
        readings=lambda s, p: {"x": s.x},
        **ports,
    )


def products(model: Model) -> set[tuple[str, str]]:
    assert isinstance(model.equations, UserEquations)
    return {(port, signal) for port, signal, _ in model.equations.products}


def test_a_parameter_multiplies_the_signals_beside_it() -> None:
    """Of the force nothing is estimated, and to the rate of the displacement no parameter
    belongs.
    """
    assert products(spring()) == {("v_rate", "x"), ("v_rate", "v")}


def test_a_declared_port_stands_for_the_rates_that_it_adds_to() -> None:
    assert products(spring(ports={"load": "N"})) == {("load", "x"), ("load", "v")}


@pytest.mark.parametrize("gain", [1e-12, 1.0, 1e9])
def test_the_size_of_a_unit_does_not_matter(gain: float) -> None:
    model = own_model(
        name="turning",
        states={"r": "rad/s"},
        inputs={"d": "rad", "e": "rad"},
        outputs={"r": "rad/s"},
        parameters={"b": (2.0 / gain, "1/s2")},
        rates=lambda s, p: {"r": gain * p.b * s.d - 0.3 * s.r + s.e},
        readings=lambda s, p: {"r": s.r},
    )
    assert products(model) == {("r_rate", "d")}


def test_each_product_has_its_parameter() -> None:
    equations = spring().equations
    assert isinstance(equations, UserEquations)
    assert {*equations.products} == {("v_rate", "x", "k"), ("v_rate", "v", "c")}


def test_functions_that_have_no_values_beside_the_starts_tell_nothing() -> None:
    """At negative r the square root has none."""
    model = own_model(
        name="draining",
        states={"h": "m"},
        inputs={"d": "m/s"},
        outputs={"h": "m"},
        parameters={"b": (0.1, "1")},
        initial={"h": 1.0},
        rates=lambda s, p: {"h": s.d - p.b * s.h**0.5},
        readings=lambda s, p: {"h": s.h},
    )
    assert products(model) == {("h_rate", "h")}
