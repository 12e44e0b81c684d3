"""Export targets, and the export as a Python module that needs only NumPy.

An aircraft as a JSBSim aircraft file: mass, coefficients as sums of terms, thrust as a force.

Inputs are properties of the file: ``flightid/elevator`` and so on in the unit of the vehicle file,
``flightid/thrust-n`` in N. The coefficients act at the reference point of the moments, from which
JSBSim moves them to the centre of gravity, as the model does [1]_.

References
----------
.. [1] J. S. Berndt et al., JSBSim, An Open Source, Platform-Independent Flight Dynamics Model in
   C++: Reference Manual, 2011.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import cos, sin
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as XML

from scenarios.export.model import (
    ExportedModel,
    Formulas,
    Operation,
    formulas_of,
    model_of_study,
    statements,
)
from scenarios.files.writing import write_content
from sim.aerodynamics import Factor, Term
from sim.declaration.effect import Signal
from sim.errors import DeclarationError
from sim.vehicles.aircraft import MOMENTS, WIND_AXES

if TYPE_CHECKING:
    from sim.vehicles.aircraft import Aircraft

_CALLS = {
    "sin": "np.sin",
    "cos": "np.cos",
    "tan": "np.tan",
    "exp": "np.exp",
    "log": "np.log",
    "sqrt": "np.sqrt",
    "tanh": "np.tanh",
    "atan": "np.arctan",
    "asin": "np.arcsin",
    "asinh": "np.arcsinh",
    "atan2": "np.arctan2",
    "abs": "np.abs",
    "maximum": "np.maximum",
    "minimum": "np.minimum",
    "choose": "np.where",
    "power": "np.power",
}
_SIMULATE = '''

def simulate(time, inputs, start=None, parameters=None, hold=True, max_step=0.02):
    """Outputs ``(len(OUTPUTS), N)`` and states ``(len(STATES), N)`` at the times ``(N,)``.

    ``inputs`` is ``(len(INPUTS), N)``; ``hold``: constant until the next sample, else straight
    lines between samples. Classical Runge-Kutta steps of ``max_step`` seconds at most.
    """
    time, inputs = np.asarray(time, dtype=float), np.asarray(inputs, dtype=float)
    if inputs.shape != (len(INPUTS), len(time)):
        raise ValueError(f"inputs has the shape {inputs.shape}, not {(len(INPUTS), len(time))}")
    start, p = START if start is None else {**START, **start}, parameters
    x = np.array([start[name] for name in STATES], dtype=float)
    states = np.empty((len(x), len(time)))
    for k in range(len(time)):
        states[:, k] = x
        if k == len(time) - 1:
            break
        first, last = inputs[:, k], inputs[:, k if hold else k + 1]
        whole = time[k + 1] - time[k]
        steps = max(1, int(np.ceil(whole / max_step - 1e-9)))
        dt = whole / steps
        for i in range(steps):
            t = time[k] + i * dt
            u0, u1, u2 = (first + (last - first) * ((i + part) / steps) for part in (0, 0.5, 1))
            k1 = derivatives(t, x, u0, p)
            k2 = derivatives(t + dt / 2, x + dt / 2 * k1, u1, p)
            k3 = derivatives(t + dt / 2, x + dt / 2 * k2, u1, p)
            k4 = derivatives(t + dt, x + dt * k3, u2, p)
            x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return outputs(time, states, inputs, p), states
'''


def python_module(model: ExportedModel) -> str:
    """Return the text of the module: names with units, values, ``derivatives``, ``outputs`` and
    ``simulate``.

    Parameters
    ----------
    model : of a study; SI and radians.

    Raises
    ------
    DeclarationError : see ``formulas_of``.
    """
    formulas = formulas_of(model.system)
    system = model.system
    values = {item.name: item.value for item in system.parameters}
    units = {item.name: item.unit for item in system.parameters}
    remarks = "".join(f"\n{each}" for each in model.remarks)
    lines = [
        f'"""{_printable(model.name)}: model {_printable(model.model)}, '
        "written by flightid export.",
        "",
        f"SI and radians; sign conventions of flightid (nz positive up).{remarks}",
        '"""',
        "",
        "import numpy as np",
        "",
        _table("STATES", system.states),
        _table("INPUTS", system.inputs),
        _table("OUTPUTS", system.outputs),
        _dictionary("START", {item.name: item.value for item in system.initial}, {}),
        _dictionary("PARAMETERS", values, units),
        "",
        "",
        "def derivatives(t, x, u, parameters=None):",
        '    """Rates of the states, ``(len(STATES), ...)``; x and u as STATES and INPUTS."""',
        *_body(formulas, formulas.rates),
        "",
        "",
        "def outputs(t, x, u, parameters=None):",
        '    """Readings of the sensors, ``(len(OUTPUTS), ...)``."""',
        *_body(formulas, formulas.outputs),
    ]
    return "\n".join(lines) + "\n" + _SIMULATE


def _printable(text: str) -> str:
    """Return the name in a form that a docstring can hold."""
    return "".join(c if c.isprintable() and c not in '"\\' else "?" for c in text)


def _table(title: str, signals: Sequence[Signal]) -> str:
    pairs = "".join(f"    {signal.name!r}: {signal.unit!r},\n" for signal in signals)
    return f"{title} = {{  # with their units\n{pairs}}}"


def _dictionary(title: str, values: dict[str, float], units: dict[str, str]) -> str:
    lines = "".join(
        f"    {name!r}: {value!r},{f'  # {units[name]}' if name in units else ''}\n"
        for name, value in values.items()
    )
    return f"{title} = {{\n{lines}}}"


def _body(formulas: Formulas, results: Sequence[int]) -> list[str]:
    """Statements of a function, indented."""
    system = formulas.system
    used = {
        formulas.operations[place].value
        for place in formulas.needed(results)
        if formulas.operations[place].name == "signal"
    }
    names = {"t": "t"}
    groups = (("x", system.state_names), ("u", system.input_names))
    names |= {
        f"{kind}:{name}": f"{kind}[{i}]" for kind, group in groups for i, name in enumerate(group)
    }
    own = [item.name for item in system.parameters if f"p:{item.name}" in used]
    names |= {f"p:{name}": _variable(name) for name in own}
    lines = ["    p = PARAMETERS if parameters is None else {**PARAMETERS, **parameters}"]
    lines += [f"    {_variable(name)} = p[{name!r}]" for name in own]
    made, result = statements(formulas, results, names, _special)
    lines += [f"    {name} = {formula}" for name, formula in made]
    lines += [
        "    shape = np.broadcast_shapes(np.shape(t), *map(np.shape, x), *map(np.shape, u))",
        f"    rows = ({''.join(f'{text}, ' for text in result)})",
        "    return np.array([np.broadcast_to(row, shape) for row in rows])",
    ]
    return lines


def _variable(name: str) -> str:
    return "p_" + re.sub(r"\W", "_", name)


def _special(operation: Operation, arguments: Sequence[str]) -> str:
    if operation.name == "interpolate":
        knots, values = operation.value
        return f"np.interp({arguments[0]}, {list(knots)!r}, {list(values)!r})"
    return f"{_CALLS[operation.name]}({', '.join(arguments)})"


def _python(model: ExportedModel) -> tuple[bytes, str]:

    return python_module(model).encode(), "needs NumPy alone"


def _fmu(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.fmu import fmu

    return fmu(model)


def _jsbsim(model: ExportedModel) -> tuple[bytes, str]:

    name = model.identifier
    return jsbsim_file(model).encode(), f"JSBSim loads it as aircraft/{name}/{name}.xml"


def _dave_ml(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.dave_ml import dave_ml_file

    return dave_ml_file(model).encode(), "coefficients and check cases, no equations of motion"


# By target: what writes the file, and the ending of its name.
_WRITERS: dict[str, tuple[Callable[[ExportedModel], tuple[bytes, str]], str]] = {
    "python": (_python, ".py"),
    "fmu": (_fmu, ".fmu"),
    "jsbsim": (_jsbsim, ".xml"),
    "dave-ml": (_dave_ml, ".dml"),
}


def written_model(
    study: Path, to: str, out: Path | None, model: Path | None
) -> tuple[Path, ExportedModel, str]:
    """Read the study's model and write it for a target: the file, the model, and a remark.

    Parameters
    ----------
    study : folder, or a vehicle file.
    to : the target.
    out : the file.
    model : the user's own.

    Raises
    ------
    DeclarationError : no such target, no model in the study, or one that cannot be written.
    """
    if to not in _WRITERS:
        raise DeclarationError(
            f"there is no target {to!r}", where="--to", remedy=f"use {' or '.join(_WRITERS)}"
        )
    write, ending = _WRITERS[to]
    result = model_of_study(study, model)
    if to in ("jsbsim", "dave-ml") and result.remarks:  # coefficients alone
        left = "Effects of the study on inputs and sensors, lags as well, are left out."
        result = replace(result, remarks=(left,))
    content, notes = write(result)
    path = out or Path(f"{result.identifier}{ending}")
    if path.is_dir():
        remedy = f"name a file, {path / (result.identifier + ending)}"
        raise DeclarationError("this is a folder", where=str(path), remedy=remedy)
    write_content(path, content)
    return path, result, notes


ROOT = "flightid"  # of the properties that the file has of its own
POUNDS = 1.0 / 4.4482216152605  # lbf in a newton
FEET = 1.0 / 0.3048  # in a metre
AXES = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")


def jsbsim_file(model: ExportedModel) -> str:
    """Return the text of the aircraft file.

    Parameters
    ----------
    model : an exported model ``aircraft``; its inputs keep their names and units.

    Returns
    -------
    XML; the file's folder and name have to be those of the aircraft (``identifier``).

    Raises
    ------
    DeclarationError : a model of another kind, or one with a wind, further states or constants that
        are columns, which JSBSim has of its own.
    """
    aircraft = model.aircraft_for("jsbsim", "JSBSim flies six degrees of freedom")
    if aircraft.varying or aircraft.wind or aircraft.recorded:
        raise DeclarationError(
            "the file has columns of constants, wind or states, which JSBSim makes itself",
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


def _inputs(aircraft: Aircraft) -> list[str]:
    """Properties that a script sets."""
    names = [f"{ROOT}/{name}" for name in aircraft.surfaces]
    return names + ([f"{ROOT}/thrust-n"] if aircraft.thrust.signal else [])


def _place(parent: XML.Element, name: str, x: float, y: float, z: float) -> None:
    """A place in JSBSim's structural frame, x aft and z up, from one in body axes, m."""
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
    """The thrust as a force of its own; its arm is measured from the centre of gravity."""
    if not aircraft.thrust.signal:
        return
    c = aircraft.constants
    outside = XML.SubElement(root, "external_reactions")
    force = XML.SubElement(outside, "force", name="thrust", frame="BODY")
    function = XML.SubElement(force, "function")
    product = XML.SubElement(function, "product")
    XML.SubElement(product, "property").text = f"{ROOT}/thrust-n"
    XML.SubElement(product, "value").text = repr(POUNDS)
    angle, arm = c["thrust_angle"], c["thrust_arm"]
    # The line of the force passes at the arm from the centre of gravity, below it where positive.
    _place(force, "THRUST", c["cg_x"] + arm * sin(angle), c["cg_y"], c["cg_z"] + arm * cos(angle))
    direction = XML.SubElement(force, "direction")
    for tag, value in (("x", cos(angle)), ("y", 0.0), ("z", -sin(angle))):
        XML.SubElement(direction, tag).text = repr(value)


def _aerodynamics(root: XML.Element, aircraft: Aircraft) -> None:
    """Coefficients as functions, then forces in lbf and moments in lbf ft by axis."""
    aero = XML.SubElement(root, "aerodynamics")
    signals = _signals(aero, aircraft)
    for axis in (*aircraft.forces, *MOMENTS):
        function = XML.SubElement(aero, "function", name=f"{ROOT}/{axis}")
        total = XML.SubElement(function, "sum")
        for term, value in aircraft.coefficients[axis].items():
            _term(total, term, value, signals)
        XML.SubElement(total, "value").text = "0.0"
    c = aircraft.constants
    lengths = {"ROLL": c["span"], "PITCH": c["chord"], "YAW": c["span"]}
    first, side, third = aircraft.forces
    for axis, coefficient in zip(AXES, (first, side, third, *MOMENTS), strict=True):
        element = XML.SubElement(aero, "axis", name=axis)
        function = XML.SubElement(element, "function", name=f"aero/{ROOT}/{axis}")
        product = XML.SubElement(function, "product")
        XML.SubElement(product, "property").text = "aero/qbar-psf"
        size = c["wing_area"] * FEET**2 * (lengths[axis] * FEET if axis in lengths else 1.0)
        XML.SubElement(product, "value").text = repr(size)
        if aircraft.forces == WIND_AXES and axis in ("X", "Z"):
            _turned(product, axis)
        else:
            XML.SubElement(product, "property").text = f"{ROOT}/{coefficient}"


def _turned(product: XML.Element, axis: str) -> None:
    """CX = CL sin(alpha) - CD cos(alpha), CZ = -CL cos(alpha) - CD sin(alpha)."""
    with_lift, with_drag = ("sin", "cos") if axis == "X" else ("cos", "sin")
    difference = XML.SubElement(product, "difference")
    signs = (1.0 if axis == "X" else -1.0, 1.0)
    for name, by, sign in (("CL", with_lift, signs[0]), ("CD", with_drag, signs[1])):
        part = XML.SubElement(difference, "product")
        XML.SubElement(part, "value").text = repr(sign)
        XML.SubElement(part, "property").text = f"{ROOT}/{name}"
        XML.SubElement(XML.SubElement(part, by), "property").text = "aero/alpha-rad"


def _signals(aero: XML.Element, aircraft: Aircraft) -> dict[str, str]:
    """Return the property of each signal of terms; non-dimensional rates and mixes as functions."""
    result = {"alpha": "aero/alpha-rad", "beta": "aero/beta-rad", "mach": f"{ROOT}/mach"}
    result |= {name: f"{ROOT}/{name}" for name in aircraft.surfaces}
    c = aircraft.constants
    for name, length in (("p", "span"), ("q", "chord"), ("r", "span")):
        result[name] = f"{ROOT}/{name}-hat"
        function = XML.SubElement(aero, "function", name=result[name])
        quotient = XML.SubElement(function, "quotient")
        above = XML.SubElement(quotient, "product")
        XML.SubElement(above, "property").text = f"velocities/{name}-aero-rad_sec"
        XML.SubElement(above, "value").text = repr(0.5 * c[length] * FEET)
        XML.SubElement(quotient, "property").text = "velocities/vt-fps"
    function = XML.SubElement(aero, "function", name=result["mach"])
    quotient = XML.SubElement(function, "quotient")
    XML.SubElement(quotient, "property").text = "velocities/vt-fps"
    XML.SubElement(quotient, "value").text = repr(c["speed_of_sound"] * FEET)
    for name, parts in aircraft.mixes.items():
        result[name] = f"{ROOT}/mixed-{name}"
        function = XML.SubElement(aero, "function", name=result[name])
        _mixed(function, parts)
    return result


def _mixed(function: XML.Element, parts: Mapping[str, float]) -> None:
    total = XML.SubElement(function, "sum")
    for name, factor in parts.items():
        product = XML.SubElement(total, "product")
        XML.SubElement(product, "property").text = f"{ROOT}/{name}"
        XML.SubElement(product, "value").text = repr(float(factor))
    XML.SubElement(total, "value").text = "0.0"


def _term(total: XML.Element, term: Term, value: float, signals: Mapping[str, str]) -> None:
    """A term times its coefficient."""
    if not term.factors:
        XML.SubElement(total, "value").text = repr(float(value))
        return
    product = XML.SubElement(total, "product")
    XML.SubElement(product, "value").text = repr(float(value))
    for factor in term.factors:
        _factor(product, factor, signals[factor.signal])


def _factor(product: XML.Element, factor: Factor, name: str) -> None:
    if factor.absolute:
        XML.SubElement(XML.SubElement(product, "abs"), "property").text = name
    elif factor.knot is None:
        for _ in range(factor.power):
            XML.SubElement(product, "property").text = name
    else:
        _spline(product, factor, name)


def _spline(product: XML.Element, factor: Factor, name: str) -> None:
    """(x - knot)^power above the knot, zero below it."""
    knot = repr(float(factor.knot or 0.0))
    comparison = XML.SubElement(product, "gt")
    XML.SubElement(comparison, "property").text = name
    XML.SubElement(comparison, "value").text = knot
    for _ in range(factor.power):
        difference = XML.SubElement(product, "difference")
        XML.SubElement(difference, "property").text = name
        XML.SubElement(difference, "value").text = knot
