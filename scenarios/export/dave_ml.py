"""The coefficients of an aircraft as a DAVE-ML file [1]_: sums of terms in MathML, and check cases.

Inputs are airspeed, alpha, beta, p, q, r and the surfaces, in SI and radians; outputs are the six
coefficients about the reference point of the moments. Mass, inertia and geometry are constants of
the file. The file has no equations of motion, thrust or sensors.

References
----------
.. [1] Flight Dynamics Model Exchange Standard, ANSI/AIAA S-119-2011.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING
from xml.etree import ElementTree as XML

from scenarios.export.model import ExportedModel
from sim.aerodynamics import Factor, Term
from sim.vehicles.aircraft import CONSTANTS, MOMENTS

if TYPE_CHECKING:
    from sim.vehicles.aircraft import Aircraft

NAMESPACE = "http://daveml.org/2010/DAVEML"
MATHML = "http://www.w3.org/1998/Math/MathML"
LENGTHS = {"p": "span", "q": "chord", "r": "span"}  # lengths that make rates non-dimensional
UNITS = {
    "1": "nd",
    "m/s": "m_s",
    "rad/s": "rad_s",
    "1/rad": "1_rad",
    "kg m2": "kgm2",
    "kg/m3": "kg_m3",
}
# Long name, unit, and change from the start in the second check case.
FLOW_INPUTS = {
    "airspeed": ("trueAirspeed", "m/s", 0.0),
    "alpha": ("angleOfAttack", "rad", 0.05),
    "beta": ("angleOfSideslip", "rad", 0.02),
    "p": ("bodyAngularRate_Roll", "rad/s", 0.1),
    "q": ("bodyAngularRate_Pitch", "rad/s", -0.05),
    "r": ("bodyAngularRate_Yaw", "rad/s", 0.08),
}
NAMES = {
    "CX": "aeroBodyForceCoefficient_X",
    "CY": "aeroBodyForceCoefficient_Y",
    "CZ": "aeroBodyForceCoefficient_Z",
    "CD": "totalCoefficientOfDrag",
    "CL": "totalCoefficientOfLift",
    "Cl": "aeroBodyMomentCoefficient_Roll",
    "Cm": "aeroBodyMomentCoefficient_Pitch",
    "Cn": "aeroBodyMomentCoefficient_Yaw",
}
CHECK_DEFLECTION = 0.03  # rad, of a surface from trim in the second check case
CHECK_AIRSPEED = 100.0  # m/s, in the second check case of a model that starts at rest
CHECK_TOLERANCE = 1e-9


def dave_ml_file(model: ExportedModel) -> str:
    """Return the text of the DAVE-ML file.

    Parameters
    ----------
    model : an exported model with equations ``aircraft``.

    Returns
    -------
    XML with the coefficients and two check cases: the start of the model, and a case with rates and
    deflected surfaces.

    Raises
    ------
    DeclarationError : the model has other equations, so it has no coefficients.
    """
    aircraft = model.aircraft_for("dave-ml", "DAVE-ML holds aerodynamic coefficients")
    root = XML.Element("DAVEfunc", xmlns=NAMESPACE)
    _header(root, model)
    for name, (long, unit, _) in FLOW_INPUTS.items():
        _variable(root, name, long, unit, is_input=True)
    for name, unit in aircraft.surfaces.items():
        _variable(root, name, f"{name}Deflection", unit, is_input=True)
    for name, unit in CONSTANTS.items():
        if name in aircraft.varying:
            _variable(root, name, name, unit, is_input=True)
        else:
            _variable(root, name, name, unit, aircraft.constants[name])
    symbols = _signals(root, aircraft)
    for name, (value, unit) in aircraft.parameters.items():
        _variable(root, name, name, unit, value)
    for axis in (*aircraft.forces, *MOMENTS):
        _coefficient(root, axis, list(aircraft.coefficients[axis]), symbols)
    _check_cases(root, model, aircraft)
    XML.indent(root)
    return XML.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _header(root: XML.Element, model: ExportedModel) -> None:
    header = XML.SubElement(root, "fileHeader", name=model.identifier)
    XML.SubElement(header, "author", name="flightid export", org="flightid")
    XML.SubElement(header, "creationDate", date=datetime.now(UTC).strftime("%Y-%m-%d"))
    text = f"Aerodynamic coefficients of {model.name}, from {model.made_by}."
    XML.SubElement(header, "description").text = " ".join((text, *model.remarks))


def _variable(
    root: XML.Element,
    name: str,
    long: str,
    unit: str,
    value: float | None = None,
    *,
    is_input: bool = False,
) -> XML.Element:
    """Add a variable: an input, a constant, or a variable whose formula follows."""
    unit_name = UNITS.get(unit, unit.replace("/", "_"))
    element = XML.SubElement(root, "variableDef", name=long, varID=name, units=unit_name)
    if value is not None:
        element.set("initialValue", repr(float(value)))
    if is_input:
        XML.SubElement(element, "isInput")
    return element


def _math(element: XML.Element) -> XML.Element:
    return XML.SubElement(XML.SubElement(element, "calculation"), "math", xmlns=MATHML)


def _apply(parent: XML.Element, operation: str) -> XML.Element:
    element = XML.SubElement(parent, "apply")
    XML.SubElement(element, operation)
    return element


def _symbol(parent: XML.Element, name: str) -> None:
    XML.SubElement(parent, "ci").text = name


def _number(parent: XML.Element, value: float) -> None:
    XML.SubElement(parent, "cn").text = repr(float(value))


def _signals(root: XML.Element, aircraft: Aircraft) -> dict[str, str]:
    """Add the variables of computed signals; return a mapping from each signal to its varID."""
    symbols = {name: name for name in ("alpha", "beta", *aircraft.surfaces)}
    for rate, length in LENGTHS.items():
        symbols[rate] = f"{rate}_hat"
        quotient = _apply(_math(_variable(root, f"{rate}_hat", f"{rate}_hat", "1")), "divide")
        numerator = _apply(quotient, "times")
        _symbol(numerator, rate)
        _symbol(numerator, length)
        denominator = _apply(quotient, "times")
        _number(denominator, 2.0)
        _symbol(denominator, "airspeed")
    symbols["mach"] = "mach"
    quotient = _apply(_math(_variable(root, "mach", "machNumber", "1")), "divide")
    _symbol(quotient, "airspeed")
    _symbol(quotient, "speed_of_sound")
    for name, parts in aircraft.mixes.items():
        symbols[name] = f"mixed_{name}"
        total = _apply(_math(_variable(root, symbols[name], symbols[name], "rad")), "plus")
        for surface, factor in parts.items():
            product = _apply(total, "times")
            _number(product, factor)
            _symbol(product, surface)
    return symbols


def _coefficient(
    root: XML.Element, axis: str, terms: list[Term], symbols: Mapping[str, str]
) -> None:
    element = _variable(root, axis, NAMES[axis], "1")
    total = _apply(_math(element), "plus")
    for term in terms:
        product = _apply(total, "times")
        _symbol(product, f"{axis}_{term.label}")
        for factor in term.factors:
            _factor(product, factor, symbols[factor.signal])
    XML.SubElement(element, "isOutput")


def _factor(product: XML.Element, factor: Factor, name: str) -> None:
    """Add a power, an absolute value or a spline of the variable ``name``."""
    if factor.absolute:
        _symbol(_apply(product, "abs"), name)
    elif factor.knot is None:
        if factor.power == 1:
            _symbol(product, name)
        else:
            power = _apply(product, "power")
            _symbol(power, name)
            _number(power, factor.power)
    else:
        pieces = XML.SubElement(product, "piecewise")
        piece = XML.SubElement(pieces, "piece")
        if factor.power == 0:
            _number(piece, 1.0)
        else:
            power = _apply(piece, "power")
            beyond_knot = _apply(power, "minus")
            _symbol(beyond_knot, name)
            _number(beyond_knot, factor.knot)
            _number(power, factor.power)
        condition = _apply(piece, "gt")
        _symbol(condition, name)
        _number(condition, factor.knot)
        _number(XML.SubElement(pieces, "otherwise"), 0.0)


# ---- Check cases: inputs, and the outputs that a program that reads the file has to find


def _check_cases(root: XML.Element, model: ExportedModel, aircraft: Aircraft) -> None:
    """Add two check cases: the start of the model, and a case with rates and deflected surfaces."""
    data = XML.SubElement(root, "checkData")
    initial = {item.name: item.value for item in model.system.initial}
    start = {name: float(initial.get(name, 0.0)) for name in FLOW_INPUTS}
    trim = {name: float(aircraft.start.get(name, 0.0)) for name in aircraft.surfaces}
    maneuver = {name: start[name] + change for name, (_, _, change) in FLOW_INPUTS.items()}
    if start["airspeed"] <= 0.0:
        maneuver["airspeed"] = CHECK_AIRSPEED
    deflections = {
        name: value + CHECK_DEFLECTION * (-1.0) ** place
        for place, (name, value) in enumerate(trim.items())
    }
    varying = {name: float(aircraft.constants[name]) for name in aircraft.varying}
    for name, values in (
        ("start", {**start, **trim, **varying}),
        ("maneuver", {**maneuver, **deflections, **varying}),
    ):
        shot = XML.SubElement(data, "staticShot", name=name)
        for part, signals, tolerance in (
            ("checkInputs", values, None),
            ("checkOutputs", coefficients_at(aircraft, values), CHECK_TOLERANCE),
        ):
            element = XML.SubElement(shot, part)
            for key, value in signals.items():
                signal = XML.SubElement(element, "signal")
                XML.SubElement(signal, "varID").text = key
                XML.SubElement(signal, "signalValue").text = repr(float(value))
                if tolerance is not None:
                    XML.SubElement(signal, "tol").text = repr(tolerance)


def coefficients_at(aircraft: Aircraft, inputs: Mapping[str, float]) -> dict[str, float]:
    """Return the six coefficients of an aircraft.

    Parameters
    ----------
    inputs : airspeed m/s, alpha, beta rad, p, q, r rad/s, and the surfaces.
    """
    half_per_airspeed = 0.5 / inputs["airspeed"] if inputs["airspeed"] else 0.0
    signals = {name: inputs[name] for name in ("alpha", "beta", *aircraft.surfaces)}
    signals |= {
        rate: inputs[rate] * aircraft.constants[length] * half_per_airspeed
        for rate, length in LENGTHS.items()
    }
    signals["mach"] = inputs["airspeed"] / aircraft.constants["speed_of_sound"]
    for name, parts in aircraft.mixes.items():
        signals[name] = sum(factor * inputs[surface] for surface, factor in parts.items())
    return {
        axis: float(sum(value * term.of(signals) for term, value in terms.items()))
        for axis, terms in aircraft.coefficients.items()
    }
