"""Export targets, and the export of a model as a Python module that needs only NumPy."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from scenarios.export.model import (
    ExportedModel,
    Formulas,
    Operation,
    formulas_of,
    model_of_study,
    statements,
)
from scenarios.files.writing import write_content
from sim.declaration.effect import Signal
from sim.errors import DeclarationError

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
    model : the model; SI and radians.

    Raises
    ------
    DeclarationError : as ``formulas_of``.
    """
    formulas = formulas_of(model.system)
    system = model.system
    values = {item.name: item.value for item in system.parameters}
    units = {item.name: item.unit for item in system.parameters}
    remarks = "".join(f"\n{remark}" for remark in model.remarks)
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
    """Return a name with ``?`` in place of characters that a docstring cannot hold."""
    return "".join(
        character if character.isprintable() and character not in '"\\' else "?"
        for character in text
    )


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
    """Return the lines of a function that computes the results, indented."""
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
    parameters = [item.name for item in system.parameters if f"p:{item.name}" in used]
    names |= {f"p:{name}": _variable(name) for name in parameters}
    lines = ["    p = PARAMETERS if parameters is None else {**PARAMETERS, **parameters}"]
    lines += [f"    {_variable(name)} = p[{name!r}]" for name in parameters]
    assignments, texts = statements(formulas, results, names, _special)
    lines += [f"    {name} = {formula}" for name, formula in assignments]
    lines += [
        "    shape = np.broadcast_shapes(np.shape(t), *map(np.shape, x), *map(np.shape, u))",
        f"    rows = ({''.join(f'{text}, ' for text in texts)})",
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
    return python_module(model).encode(), "needs only NumPy"


def _fmu(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.fmu import fmu

    return fmu(model)


def _jsbsim(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.jsbsim import jsbsim_file

    name = model.identifier
    return jsbsim_file(model).encode(), f"JSBSim loads it as aircraft/{name}/{name}.xml"


def _dave_ml(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.dave_ml import dave_ml_file

    return dave_ml_file(model).encode(), "coefficients and check cases, no equations of motion"


# Target -> function that returns the content of the file and a remark on it, and its suffix.
_WRITERS: dict[str, tuple[Callable[[ExportedModel], tuple[bytes, str]], str]] = {
    "python": (_python, ".py"),
    "fmu": (_fmu, ".fmu"),
    "jsbsim": (_jsbsim, ".xml"),
    "dave-ml": (_dave_ml, ".dml"),
}


def written_model(
    study: Path, to: str, out: Path | None, model: Path | None
) -> tuple[Path, ExportedModel, str]:
    """Write the model of a study for a target, and return the file, the model, and a remark.

    Parameters
    ----------
    study : folder of the study, or a vehicle file.
    to : the target.
    out : file to write; None takes a name from that of the vehicle.
    model : file of the user's model of the study; None for other models.

    Raises
    ------
    DeclarationError : there is no such target, the study has no model, or its model cannot be
        written for the target.
    """
    if to not in _WRITERS:
        raise DeclarationError(
            f"there is no target {to!r}", where="--to", remedy=f"use {' or '.join(_WRITERS)}"
        )
    content_of, suffix = _WRITERS[to]
    result = model_of_study(study, model)
    if to in ("jsbsim", "dave-ml") and result.remarks:  # these files have only coefficients
        left_out = "Effects of the study on inputs and sensors, lags as well, are left out."
        result = replace(result, remarks=(left_out,))
    content, remark = content_of(result)
    path = out or Path(f"{result.identifier}{suffix}")
    if path.is_dir():
        remedy = f"name a file, {path / (result.identifier + suffix)}"
        raise DeclarationError("this is a folder", where=str(path), remedy=remedy)
    write_content(path, content)
    return path, result, remark
