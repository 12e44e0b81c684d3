"""An aircraft as a JSBSim aircraft file: mass, coefficients as sums of terms, thrust as a force.

Inputs are properties of the file: ``flightid/elevator`` and so on in the unit of the vehicle file,
``flightid/thrust-n`` in N. The coefficients act at the reference point of the moments, from which
JSBSim moves them to the centre of gravity, as the model does [1]_.

References
----------
.. [1] J. S. Berndt et al., JSBSim, An Open Source, Platform-Independent Flight Dynamics Model in
   C++: Reference Manual, 2011.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin
from typing import TYPE_CHECKING
from xml.etree import ElementTree as XML

from scenarios.export.model import ExportedModel
from sim.aerodynamics import Factor, Term
from sim.errors import DeclarationError
from sim.vehicles.aircraft import MOMENTS, WIND_AXES

if TYPE_CHECKING:
    from sim.vehicles.aircraft import Aircraft

ROOT = "flightid"  # first part of the names of properties that only this file has
POUNDS = 1.0 / 4.4482216152605  # lbf in a newton
FEET = 1.0 / 0.3048  # ft in a metre
AXES = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")


def jsbsim_file(model: ExportedModel) -> str:
    """Return the text of the aircraft file.

    Parameters
    ----------
    model : an exported model ``aircraft``; its inputs keep their names and units.

    Returns
    -------
    XML. JSBSim needs the ``identifier`` of the model as name of the file and of its folder.

    Raises
    ------
    DeclarationError : the model is no ``aircraft``, or it reads constants, wind or states from
        columns of a record; JSBSim computes these.
    """
    aircraft = model.aircraft_for("jsbsim", "JSBSim flies six degrees of freedom")
    if aircraft.varying or aircraft.wind or aircraft.recorded:
        raise DeclarationError(
            "the file takes constants, wind or states from a record, and JSBSim computes these",
            where="--to jsbsim",
            remedy="give constants their values, and leave columns, wind and recorded out",
        )
    root = XML.Element("fdm_config", name=model.identifier, version="2.0", release="ALPHA")
    header = XML.SubElement(root, "fileheader")
    for tag, text in (
        ("author", "flightid export"),
        ("description", f"{model.name}: coefficients of {model.made_by}"),
    ):
        XML.SubElement(header, tag).text = text
    for remark in model.remarks:
        XML.SubElement(header, "note").text = remark
    _metrics(root, aircraft)
    _mass(root, aircraft)
    XML.SubElement(root, "ground_reactions")
    _thrust(root, aircraft)
    XML.SubElement(root, "propulsion")
    control = XML.SubElement(root, "flight_control", name="inputs")
    for name in _inputs(aircraft):
        XML.SubElement(control, "property", value="0").text = name
    _aerodynamics(root, aircraft)
    XML.indent(root)
    return XML.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _property(parent: XML.Element, name: str) -> None:
    XML.SubElement(parent, "property").text = name


def _value(parent: XML.Element, number: float) -> None:
    XML.SubElement(parent, "value").text = repr(float(number))


def _inputs(aircraft: Aircraft) -> list[str]:
    names = [f"{ROOT}/{name}" for name in aircraft.surfaces]
    return names + ([f"{ROOT}/thrust-n"] if aircraft.thrust.signal else [])


def _place(parent: XML.Element, name: str, x: float, y: float, z: float) -> None:
    """Add a place in JSBSim's structural frame, x aft and z up; x, y and z are in body axes, m."""
    place = XML.SubElement(parent, "location", name=name, unit="M")
    for tag, value in (("x", -x), ("y", y), ("z", -z)):
        XML.SubElement(place, tag).text = repr(float(value))


def _metrics(root: XML.Element, aircraft: Aircraft) -> None:
    metrics, c = XML.SubElement(root, "metrics"), aircraft.constants
    for tag, name, unit in (
        ("wingarea", "wing_area", "M2"),
        ("wingspan", "span", "M"),
        ("chord", "chord", "M"),
    ):
        XML.SubElement(metrics, tag, unit=unit).text = repr(float(c[name]))
    _place(metrics, "AERORP", 0.0, 0.0, 0.0)
    _place(metrics, "EYEPOINT", 0.0, 0.0, 0.0)
    _place(metrics, "VRP", 0.0, 0.0, 0.0)


def _mass(root: XML.Element, aircraft: Aircraft) -> None:
    c = aircraft.constants
    mass = XML.SubElement(root, "mass_balance", negated_crossproduct_inertia="false")
    for tag, name in (
        ("ixx", "roll_inertia"),
        ("iyy", "pitch_inertia"),
        ("izz", "yaw_inertia"),
        ("ixz", "cross_inertia"),
    ):
        XML.SubElement(mass, tag, unit="KG*M2").text = repr(float(c[name]))
    XML.SubElement(mass, "emptywt", unit="KG").text = repr(float(c["mass"]))
    _place(mass, "CG", c["cg_x"], c["cg_y"], c["cg_z"])


def _thrust(root: XML.Element, aircraft: Aircraft) -> None:
    """Add the thrust as a force; its arm is measured from the centre of gravity."""
    if not aircraft.thrust.signal:
        return
    c = aircraft.constants
    outside = XML.SubElement(root, "external_reactions")
    force = XML.SubElement(outside, "force", name="thrust", frame="BODY")
    function = XML.SubElement(force, "function")
    product = XML.SubElement(function, "product")
    _property(product, f"{ROOT}/thrust-n")
    _value(product, POUNDS)
    angle, arm = c["thrust_angle"], c["thrust_arm"]
    # The line of the force passes at the arm from the centre of gravity, below it where positive.
    _place(force, "THRUST", c["cg_x"] + arm * sin(angle), c["cg_y"], c["cg_z"] + arm * cos(angle))
    direction = XML.SubElement(force, "direction")
    for tag, value in (("x", cos(angle)), ("y", 0.0), ("z", -sin(angle))):
        XML.SubElement(direction, tag).text = repr(value)


def _aerodynamics(root: XML.Element, aircraft: Aircraft) -> None:
    """Add the coefficients as functions, then forces in lbf and moments in lbf ft by axis."""
    aero = XML.SubElement(root, "aerodynamics")
    signals = _signals(aero, aircraft)
    for axis in (*aircraft.forces, *MOMENTS):
        function = XML.SubElement(aero, "function", name=f"{ROOT}/{axis}")
        total = XML.SubElement(function, "sum")
        for term, value in aircraft.coefficients[axis].items():
            _term(total, term, value, signals)
        _value(total, 0.0)
    c = aircraft.constants
    lengths = {"ROLL": c["span"], "PITCH": c["chord"], "YAW": c["span"]}
    for axis, coefficient in zip(AXES, (*aircraft.forces, *MOMENTS), strict=True):
        element = XML.SubElement(aero, "axis", name=axis)
        function = XML.SubElement(element, "function", name=f"aero/{ROOT}/{axis}")
        product = XML.SubElement(function, "product")
        _property(product, "aero/qbar-psf")
        size = c["wing_area"] * FEET**2 * (lengths[axis] * FEET if axis in lengths else 1.0)
        _value(product, size)
        if aircraft.forces == WIND_AXES and axis in ("X", "Z"):
            _turned(product, axis)
        else:
            _property(product, f"{ROOT}/{coefficient}")


def _turned(product: XML.Element, axis: str) -> None:
    """Add CX = CL sin(alpha) - CD cos(alpha), or CZ = -CL cos(alpha) - CD sin(alpha)."""
    with_lift, with_drag = ("sin", "cos") if axis == "X" else ("cos", "sin")
    difference = XML.SubElement(product, "difference")
    signs = (1.0 if axis == "X" else -1.0, 1.0)
    for name, by, sign in (("CL", with_lift, signs[0]), ("CD", with_drag, signs[1])):
        part = XML.SubElement(difference, "product")
        _value(part, sign)
        _property(part, f"{ROOT}/{name}")
        _property(XML.SubElement(part, by), "aero/alpha-rad")


def _signals(aero: XML.Element, aircraft: Aircraft) -> dict[str, str]:
    """Return signal of the terms -> property. Functions of rates, Mach number, mixes are added."""
    result = {"alpha": "aero/alpha-rad", "beta": "aero/beta-rad", "mach": f"{ROOT}/mach"}
    result |= {name: f"{ROOT}/{name}" for name in aircraft.surfaces}
    c = aircraft.constants
    for name, length in (("p", "span"), ("q", "chord"), ("r", "span")):
        result[name] = f"{ROOT}/{name}-hat"
        function = XML.SubElement(aero, "function", name=result[name])
        quotient = XML.SubElement(function, "quotient")
        above = XML.SubElement(quotient, "product")
        _property(above, f"velocities/{name}-aero-rad_sec")
        _value(above, 0.5 * c[length] * FEET)
        _property(quotient, "velocities/vt-fps")
    function = XML.SubElement(aero, "function", name=result["mach"])
    quotient = XML.SubElement(function, "quotient")
    _property(quotient, "velocities/vt-fps")
    _value(quotient, c["speed_of_sound"] * FEET)
    for name, parts in aircraft.mixes.items():
        result[name] = f"{ROOT}/mixed-{name}"
        function = XML.SubElement(aero, "function", name=result[name])
        _mixed(function, parts)
    return result


def _mixed(function: XML.Element, parts: Mapping[str, float]) -> None:
    total = XML.SubElement(function, "sum")
    for name, factor in parts.items():
        product = XML.SubElement(total, "product")
        _property(product, f"{ROOT}/{name}")
        _value(product, factor)
    _value(total, 0.0)


def _term(total: XML.Element, term: Term, value: float, signals: Mapping[str, str]) -> None:
    if not term.factors:
        _value(total, value)
        return
    product = XML.SubElement(total, "product")
    _value(product, value)
    for factor in term.factors:
        _factor(product, factor, signals[factor.signal])


def _factor(product: XML.Element, factor: Factor, name: str) -> None:
    """Add a power, an absolute value or a spline of the property ``name``."""
    if factor.absolute:
        _property(XML.SubElement(product, "abs"), name)
    elif factor.knot is None:
        for _ in range(factor.power):
            _property(product, name)
    else:
        _spline(product, factor, name)


def _spline(product: XML.Element, factor: Factor, name: str) -> None:
    """Add (x - knot)^power above the knot, zero below it."""
    knot = factor.knot or 0.0
    comparison = XML.SubElement(product, "gt")
    _property(comparison, name)
    _value(comparison, knot)
    for _ in range(factor.power):
        difference = XML.SubElement(product, "difference")
        _property(difference, name)
        _value(difference, knot)
