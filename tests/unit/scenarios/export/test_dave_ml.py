"""The DAVE-ML file read back by a small reader of MathML, against the terms it was written from."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, reduce
from types import SimpleNamespace
from xml.etree import ElementTree as XML

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.export.dave_ml import MATHML, NAMESPACE, dave_ml_file
from scenarios.export.model import exported
from sim.aerodynamics import FLOW, parse_term
from sim.declaration.model import Model
from sim.errors import DeclarationError
from sim.vehicles.aircraft import Aircraft, aircraft_model
from tests.airliner import AIRLINER, CONSTANTS
from tests.bases import rigid_model

D, M = f"{{{NAMESPACE}}}", f"{{{MATHML}}}"
SURFACES = {"left": "rad", "right": "rad", "rudder": "rad"}
MIXES = {"elevator": {"left": 0.5, "right": 0.5}, "aileron": {"left": 0.5, "right": -0.5}}
TEXTS = {
    "CX": {"1": -0.03, "alpha^2": 0.9, "spline(alpha, 0.05, 0)": -0.01, "mach": -0.02},
    "CY": {"beta": -0.9, "beta*abs(beta)": 0.3, "rudder": 0.2},
    "CZ": {"1": -0.3, "alpha": -5.0, "spline(alpha, 0.08, 2)": 7.0, "q": -6.0, "elevator": -0.4},
    "Cl": {"beta": -0.1, "p": -0.5, "alpha*r": 0.4, "aileron": -0.13},
    "Cm": {"1": 0.05, "alpha": -1.0, "q": -20.0, "alpha*elevator": 3.0, "elevator^3": 0.6},
    "Cn": {"beta": 0.13, "beta^3": 0.4, "r": -0.2, "spline(alpha, 0.02, 1)*rudder": -0.3},
}
OPERATIONS: dict[str, Callable[..., float]] = {
    "plus": lambda *x: sum(x),
    "minus": lambda x, y: x - y,
    "times": lambda *x: reduce(lambda a, b: a * b, x),
    "divide": lambda x, y: x / y,
    "power": lambda x, y: x**y,
    "abs": abs,
    "gt": lambda x, y: float(x > y),
}


@cache
def aircraft() -> Aircraft:
    names = (*FLOW, *SURFACES, *MIXES)
    terms = {
        axis: {parse_term(text, names): value for text, value in table.items()}
        for axis, table in TEXTS.items()
    }
    start = {"airspeed": 130.0, "alpha": 0.03, "theta": 0.03}
    return Aircraft('mixed "one" & <two>', CONSTANTS, SURFACES, terms, MIXES, start=start)


@cache
def model() -> Model:
    return aircraft_model(aircraft())


@cache
def document() -> XML.Element:
    plane = aircraft()
    return XML.fromstring(dave_ml_file(exported(plane.name, model(), aircraft=plane)))


def evaluated(inputs: dict[str, float]) -> dict[str, float]:
    """All variables of the file in its order: each may use those before it."""
    known = dict(inputs)

    def value(element: XML.Element) -> float:
        tag = element.tag.removeprefix(M)
        if tag == "ci":
            return known[str(element.text)]
        if tag == "cn":
            return float(str(element.text))
        if tag == "piecewise":
            for piece in element.findall(f"{M}piece"):
                if value(piece[1]):
                    return value(piece[0])
            return value(element.find(f"{M}otherwise")[0])  # type: ignore[index]
        assert tag == "apply"
        return float(OPERATIONS[element[0].tag.removeprefix(M)](*map(value, element[1:])))

    for variable in document().iter(f"{D}variableDef"):
        name = variable.attrib["varID"]
        formula = variable.find(f"{D}calculation/{M}math")
        if formula is not None:
            known[name] = value(formula[0])
        elif variable.find(f"{D}isInput") is None:
            known[name] = float(variable.attrib["initialValue"])
    return known


ANGLE = st.floats(-0.3, 0.3)


@settings(max_examples=40, deadline=None)
@given(st.floats(50.0, 250.0), st.lists(ANGLE, min_size=8, max_size=8))
def test_the_file_gives_the_coefficients_of_the_model(speed: float, angles: list[float]) -> None:
    names = ("alpha", "beta", "p", "q", "r", *SURFACES)
    inputs = {"airspeed": speed, **dict(zip(names, angles, strict=True))}
    found = evaluated(inputs)
    # The equations of the model as the oracle: their sums of terms at this state.
    s = SimpleNamespace(**inputs, phi=0.0, theta=0.0, thrust=0.0)
    p = SimpleNamespace(**{item.name: item.value for item in model().parameters})
    told = model().equations.flow(s, p)
    for axis in TEXTS:
        assert found[axis] == pytest.approx(told[f"{axis}_terms"], rel=1e-9, abs=1e-12)


def test_check_cases_hold() -> None:
    shots = document().findall(f"{D}checkData/{D}staticShot")
    assert [shot.attrib["name"] for shot in shots] == ["start", "maneuver"]
    for shot in shots:
        read = {
            part: {
                str(signal.findtext(f"{D}varID")): float(str(signal.findtext(f"{D}signalValue")))
                for signal in shot.findall(f"{D}{part}/{D}signal")
            }
            for part in ("checkInputs", "checkOutputs")
        }
        found = evaluated(read["checkInputs"])
        assert set(read["checkOutputs"]) == set(TEXTS)
        for axis, wanted in read["checkOutputs"].items():
            assert math.isclose(found[axis], wanted, abs_tol=1e-9)


def test_names_are_escaped_and_outputs_marked() -> None:
    text = document().findtext(f"{D}fileHeader/{D}description")
    assert text is not None and 'mixed "one" & <two>' in text
    outputs = [
        each.attrib["varID"]
        for each in document().iter(f"{D}variableDef")
        if each.find(f"{D}isOutput") is not None
    ]
    assert outputs == list(TEXTS)
    units = {
        each.attrib["varID"]: each.attrib["units"] for each in document().iter(f"{D}variableDef")
    }
    assert units["airspeed"] == "m_s" and units["Cm_alpha_elevator"] == "1_rad2"


def test_another_model_is_refused() -> None:
    with pytest.raises(DeclarationError, match="aerodynamic coefficients"):
        dave_ml_file(exported("bomber", rigid_model()))


def test_lift_and_drag_are_written_as_such() -> None:
    text = dave_ml_file(exported("airliner", aircraft_model(AIRLINER), aircraft=AIRLINER))
    assert "totalCoefficientOfLift" in text and "aeroBodyForceCoefficient_X" not in text
