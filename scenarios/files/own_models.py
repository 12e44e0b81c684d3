"""A user's own model: the Python file that declares it, and the vehicle file that gives its numbers."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS, TIME
from scenarios.files.constraints import Constraints, refuse_nothing_left, take_constraints
from scenarios.files.declarations import closest, toml_of
from scenarios.files.python_files import WANTED, run_python
from scenarios.files.sources import InputFile, Source, read_source
from sim.declaration.model import Model
from sim.declaration.user_equations import OwnEquations, Starts, parameters_asked
from sim.errors import DeclarationError, ModelError

SUFFIX = ".py"
NOT_KEYS = ("name", "derivatives", "fixed", "bounds", "tied")  # of a vehicle file, which a constant's would hide
SHORT_PERIOD = ("alpha", "q", "nz")  # channels that the kinematics of pitching join
EXAMPLE = "MODEL = own_model(...) as docs/own-models.md shows"


@dataclass(frozen=True, eq=False)
class OwnModel:
    """A model that a file declares, at the file's own starts, and the file with its hash; of one that never was in a file its name and numbers'."""

    model: Model
    identity: InputFile


def is_model_file(name: str | OwnModel) -> bool:
    """Whether ``--model`` names a user's file: one that ends in .py, or a path; a model in memory is as good."""
    return isinstance(name, OwnModel) or name.endswith(SUFFIX) or "/" in name or "\\" in name


def is_own(model: Model) -> bool:
    """Whether a model is a user's own: its signals mean what its file says, whatever their names."""
    return isinstance(model.equations, OwnEquations)


def is_of_aircraft(model: Model) -> bool:
    """Whether a model speaks of an aircraft's short period: built in, or with its channels and its airspeed by their names and in their units.

    Of such an own model the kinematics say what they say of a built-in one, and its channels have the same words.
    """
    if not is_own(model):
        return True
    outputs = {signal.name: signal.unit for signal in model.equations.outputs}
    speed = "airspeed" in model.parameters and model.parameters["airspeed"].unit == CHANNEL_UNITS["airspeed"]
    return speed and all(outputs.get(name) == CHANNEL_UNITS[name] for name in SHORT_PERIOD)


def inputs_at_rest(model: Model) -> list[float]:
    """The inputs about which a model is tried: zero unless its file says otherwise."""
    equations = model.equations
    declared = equations.resting_inputs if isinstance(equations, OwnEquations) else {}
    return [declared.get(signal.name, 0.0) for signal in equations.inputs]


def moves_about_rest(model: Model) -> bool:
    """Whether a natural frequency is asked: not of an own model that starts elsewhere than at rest, about which it need not move."""
    return not is_own(model) or not (np.any(model.initial.values()) or any(inputs_at_rest(model)))


def unit_in(model: Model, name: str) -> str:
    """The unit that a model declares for a state, an input, an output or a parameter; 1 where it has no such name."""
    e = model.equations
    signals = {signal.name: signal.unit for signal in (*e.states, *e.inputs, *e.outputs)}
    return signals[name] if name in signals else model.parameters[name].unit if name in model.parameters else "1"


def read_own_model(path: str | Path, built_in: tuple[str, ...] = ()) -> OwnModel:
    """The ``MODEL`` of a user's Python file, which is run once; what the file says of itself becomes the equations' explanation.

    Raises
    ------
    DeclarationError : no such file, an error in it (with its line), no ``MODEL`` in it, or one that ``own_model`` did not make or that has the
        name of one ``built_in``.
    """
    source = read_source(path, DeclarationError, WANTED)
    where = str(source.path)
    module = run_python(source, "model")
    if not hasattr(module, "MODEL"):
        raise DeclarationError("it declares no MODEL", where=where, remedy=f"put {EXAMPLE} at its top level")
    model = checked_model(module.MODEL, where, built_in)
    equations: Any = model.equations
    _refuse_unused(model, equations, source)
    return OwnModel(replace(model, equations=replace(equations, explanation=(module.__doc__ or "").strip())), source.identity)


def model_in_memory(model: object, built_in: tuple[str, ...] = ()) -> OwnModel:
    """A user's own model that was made in Python and stands in no file. Raises DeclarationError as ``read_own_model``."""
    own = checked_model(model, "model", built_in)
    numbers = repr([(item.name, item.value, item.unit, item.free) for item in (*own.parameters, *own.initial)])
    return OwnModel(own, InputFile(own.name, hashlib.sha256(f"{own.name}: {numbers}".encode()).hexdigest()))


def checked_model(model: object, where: str, built_in: tuple[str, ...] = ()) -> Model:
    """The model, if it is one of a user's own whose names can serve. Raises DeclarationError."""
    if not isinstance(model, Model) or not is_own(model):
        raise DeclarationError(f"its MODEL is of type {type(model).__name__}", where=where, remedy=f"make it with own_model, {EXAMPLE}")
    if model.name in built_in:
        raise DeclarationError(f"the model {model.name!r} is built in", where=where, remedy="give yours another name")
    for name in NOT_KEYS:
        if name in model.parameters and not model.parameters[name].free:
            raise DeclarationError(f"a constant {name!r} has no place in a vehicle file", where=where, remedy="give it another name")
    return model


def _refuse_unused(model: Model, equations: OwnEquations, source: Source) -> None:
    """Raise DeclarationError, with its line, for a parameter that no equation has: none asks for it, and nowhere in the file is it spelt as one."""
    rest = dict(zip((signal.name for signal in equations.inputs), inputs_at_rest(model), strict=True))
    signals = {TIME: 0.0, **{item.name: item.value for item in model.initial}, **rest, **{port.name: 0.0 for port in equations.ports}}
    asked = parameters_asked(equations, Starts(signals, {item.name: item.value for item in model.parameters}))
    nodes = [*ast.walk(ast.parse(source.content))]
    spelt = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    for name in model.parameters.free_names:
        if name not in asked and name not in spelt:
            lines = [node.lineno for node in nodes if isinstance(node, ast.Constant) and node.value == name]
            where = f"{source.path}{f', line {lines[0]}' if lines else ''}: model {model.name}, parameters, {name}"
            raise DeclarationError("it is in no equation", where=where, remedy="use it, or leave it out")


def own_numbers(own: OwnModel, source: Source) -> tuple[str, Model, Constraints]:
    """Name of the vehicle, the model with the constants and starts that a vehicle file gives, and what the file lays down about them.

    What the file leaves out stays as the model says; the constraints are not in the model yet.

    Raises
    ------
    DeclarationError : one line with file, key and remedy: not TOML, an unknown key, a value of the wrong kind or unit or beyond its bounds.
    """
    from scenarios.files.vehicles_schema import number_in

    path, content = source.path, toml_of(source)
    free = [item for item in own.model.parameters if item.free]
    laid_down = take_constraints(content, {item.name: item.unit for item in free}, path, {item.name: item.value for item in free})
    name, starts = content.pop("name", path.stem), content.pop("derivatives", {})
    if not isinstance(name, str) or not name:
        raise DeclarationError(f"{name!r} is no name", where=f"{path}, key name", remedy='write name = "..."')
    if not isinstance(starts, dict):
        raise DeclarationError("this is no table", where=f"{path}, key derivatives", remedy="write [derivatives], and below it the starts")
    given = {item.name: item for item in own.model.parameters}
    values = {}
    for table, is_free, keys in ((content, False, ""), (starts, True, "derivatives.")):
        known = [item.name for item in given.values() if item.free is is_free]
        for key, value in table.items():
            where = f"{path}, key {keys}{key}"
            if key not in known:
                raise DeclarationError("there is no such key", where=where, remedy=_remedy(key, known, free=is_free, other=key in given))
            values[key] = number_in(value, given[key].unit, where)
    try:
        model = own.model.with_values(values)
    except ModelError as error:
        raise DeclarationError(f"{error.where}: {error.what}", where=str(path), remedy=error.remedy) from None
    refuse_nothing_left(laid_down, [item.name for item in free], path)
    return name, model, laid_down


def channel_units(model: Model) -> Mapping[str, str]:
    """Channel -> unit inside, of all channels that a record for this model may hold: an own model says itself what its names mean."""
    if not is_own(model):
        return CHANNEL_UNITS
    return {TIME: "s", **{signal.name: signal.unit for signal in (*model.equations.inputs, *model.equations.outputs)}}


def _remedy(key: str, known: list[str], *, free: bool, other: bool) -> str:
    if other:
        return "it is a constant: put it above [derivatives]" if free else "it is a parameter: put it under [derivatives]"
    what = "parameters" if free else "constants"
    return closest(key, known) if known else f"the model has no {what}"
