"""Users' models: the Python file that declares a model, the vehicle file with its values, and the
constraints on its parameters.
"""

from __future__ import annotations

import ast
import hashlib
import math
from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, TIME, WANTED, closest, run_python, toml_of
from scenarios.files.sources import InputFile, Source, read_source
from sim.declaration.model import Model, Tie
from sim.declaration.user_equations import TrialPoint, UserEquations, parameters_read
from sim.errors import DeclarationError, ModelError

# ---- Constraints that a vehicle file puts on parameters

TABLES = ("fixed", "bounds", "tied")
FLYING_QUALITIES_KEYS = ("aircraft_class", "flight_phase")
STARTS = "derivatives"
# A value this near to a bound is at the bound; relative to the larger bound. It covers rounding.
_BOUND_TOLERANCE = 1e-9
_TIE = 'write NAME = {parameter = "OTHER", factor = 0.5}, or a list of such terms'
_NO_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType({})


@dataclass(frozen=True)
class Constraints:
    """Constraints of a vehicle file, in SI units.

    Attributes
    ----------
    fixed : names of the parameters that a fit holds at their starts.
    bounds : (low, high) by parameter.
    ties : parameters that are linear functions of other parameters.
    """

    fixed: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _NO_BOUNDS)
    ties: tuple[Tie, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.fixed or self.bounds or self.ties)


NONE = Constraints()


def take_constraints(
    content: dict[str, Any],
    units: Mapping[str, str],
    path: str | Path,
    defaults: Mapping[str, float] | None = None,
) -> Constraints:
    """Remove the tables of constraints from a vehicle file's content (in place) and return them.

    Values of fixed and tied parameters are added to the starting values.

    Parameters
    ----------
    content : the file as read. Its table ``[derivatives]`` receives the starts of the parameters
        that ``[fixed]`` gives a value or that ``[tied]`` defines.
    units : SI unit by parameter that can be estimated.
    defaults : starting values, SI, of parameters that the file may omit.

    Raises
    ------
    DeclarationError : an unknown parameter; a parameter given twice; bounds in the wrong order or
        bounds that exclude the start; a tie to the parameter itself or to a tied parameter; a tie
        of another form. The message has file, key and remedy in one line.
    """
    given = {table: content.pop(table, {}) for table in TABLES}
    if all(table == {} for table in given.values()):
        return NONE
    starts = content.setdefault(STARTS, {})
    if not isinstance(starts, dict):
        return NONE  # the reader of [derivatives] reports this error
    modes = content.get("modes")
    # A ChainMap writes into its first map only: new starts go into [derivatives].
    start_values = ChainMap(
        starts,
        *(table for table in (modes if isinstance(modes, list) else ()) if isinstance(table, dict)),
        dict(defaults or {}),
    )
    fixed = _fixed(given["fixed"], start_values, units, path)
    ties = _ties(given["tied"], start_values, units, fixed, path)
    held = (*fixed, *(tie.name for tie in ties))
    bounds = _bounds(given["bounds"], start_values, units, held, path)
    return Constraints(fixed, bounds, ties)


def with_place(
    error: DeclarationError, constraints: Constraints, path: str | Path
) -> DeclarationError:
    """Return an error about a start with the key that the user wrote.

    A start from ``[fixed]`` or ``[tied]`` was moved to ``[derivatives]``; the error names that key.
    """
    tables = dict.fromkeys(constraints.fixed, "fixed") | {
        tie.name: "tied" for tie in constraints.ties
    }
    for name, table in tables.items():
        if error.where == f"{path}, key {STARTS}.{name}":
            return DeclarationError(
                error.what, where=f"{path}, key {table}.{name}", remedy=error.remedy
            )
    return error


def refuse_nothing_left(constraints: Constraints, starts: Iterable[str], path: str | Path) -> None:
    """Raise DeclarationError if all of the ``starts`` are fixed or tied to fixed parameters."""
    held = {*constraints.fixed, *(tie.name for tie in constraints.ties)}
    if held and held.issuperset(starts):
        raise DeclarationError(
            "every parameter is fixed or tied: nothing is left to estimate",
            where=str(path),
            remedy="leave one parameter free at least",
        )


def side_at(value: float, bounds: tuple[float, float]) -> str:
    """Return ``"lower"`` or ``"upper"`` if a value is at one of its bounds, else an empty text."""
    low, high = bounds
    tolerance = _BOUND_TOLERANCE * max(abs(end) if math.isfinite(end) else 0.0 for end in bounds)
    if math.isfinite(low) and low - value >= -tolerance:
        return "lower"
    if math.isfinite(high) and value - high >= -tolerance:
        return "upper"
    return ""


def constrained(model: Model, constraints: Constraints) -> Model:
    """Return a model with the constraints of a file; of two bounds the narrower one applies."""
    if not constraints:
        return model
    parameters = model.parameters.hold(constraints.fixed)
    bounds = {}
    for name, (low, high) in constraints.bounds.items():
        model_bounds = parameters[name].bounds
        bounds[name] = (max(low, model_bounds[0]), min(high, model_bounds[1]))
    return model.with_parameters(parameters.with_bounds(bounds)).with_ties(constraints.ties)


def constraint_sentences(constraints: Constraints, model: Model) -> tuple[str, ...]:
    """Return a sentence on the fixed, the tied and the bounded parameters, if there are any."""
    sentences = []
    starts = {item.name: item.value for item in model.parameters}
    units = {item.name: item.unit for item in model.parameters}
    if constraints.fixed:
        entries = [
            f"{name} = {starts[name]:.6g}{_unit(units.get(name, '1'))}"
            for name in constraints.fixed
        ]
        sentences.append(f"held by the vehicle file: {', '.join(entries)}")
    if constraints.ties:
        sentences.append(
            f"tied by the vehicle file: {', '.join(tie.words for tie in constraints.ties)}"
        )
    if constraints.bounds:
        entries = [
            f"{name} from {low:g} to {high:g}{_unit(units.get(name, '1'))}"
            for name, (low, high) in constraints.bounds.items()
        ]
        sentences.append(f"bounded by the vehicle file: {', '.join(entries)}")
    return tuple(sentences)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _fixed(
    table: Any, starts: ChainMap[str, Any], units: Mapping[str, str], path: str | Path
) -> tuple[str, ...]:
    """Return the fixed parameters.

    ``fixed = ["A"]`` holds A at its start. ``[fixed] A = 1.0`` gives the value, which becomes the
    start.
    """
    if isinstance(table, list):
        where = f"{path}, key fixed"
        for name in table:
            _refuse_unknown(name, units, where)
            if name not in starts:
                raise DeclarationError(
                    f"{name} has no value to be fixed at",
                    where=where,
                    remedy=f"give it under [{STARTS}], or write [fixed] {name} = ...",
                )
        return tuple(dict.fromkeys(table))
    for name, value in _table(
        table, "fixed", path, 'write [fixed] with NAME = value, or fixed = ["NAME"] at the top'
    ).items():
        where = f"{path}, key fixed.{name}"
        _refuse_unknown(name, units, where)
        _refuse_second_entry(name, starts, where)
        starts[name] = _number(value, units[name], where)
    return tuple(table)


def _ties(
    table: Any,
    starts: ChainMap[str, Any],
    units: Mapping[str, str],
    fixed: Iterable[str],
    path: str | Path,
) -> tuple[Tie, ...]:
    """Return the ties, checked; each tied parameter gets the start that its tie gives."""
    ties: list[Tie] = []
    entries = _table(table, "tied", path, _TIE)
    for name, entry in entries.items():
        where = f"{path}, key tied.{name}"
        _refuse_unknown(name, units, where)
        if name in fixed:
            raise DeclarationError(
                "given twice, also under fixed", where=where, remedy="keep one of the two"
            )
        _refuse_second_entry(name, starts, where)
        ties.append(_tie(name, entry, units, where))
    for tie in ties:
        where = f"{path}, key tied.{tie.name}"
        for source in tie.sources:
            if source in entries:
                what = "it follows itself" if source == tie.name else f"{source} is tied itself"
                raise DeclarationError(
                    what, where=where, remedy="tie it to parameters that are not tied"
                )
            if source not in starts:
                raise DeclarationError(
                    f"{source}, which it follows, has no start",
                    where=where,
                    remedy=f"give {source} under [{STARTS}]",
                )
    for tie in ties:
        starts[tie.name] = float(tie.of(lambda source: _start(source, starts, units, path)))
    return tuple(ties)


def _tie(name: str, entry: Any, units: Mapping[str, str], where: str) -> Tie:
    terms, constant = [], 0.0
    for term in entry if isinstance(entry, list) else [entry]:
        if not isinstance(term, dict) or not set() < {*term} <= {"parameter", "factor", "constant"}:
            raise DeclarationError("this is no tie", where=where, remedy=_TIE)
        if "constant" in term:
            constant += _number(term["constant"], units[name], where)
        if ("parameter" in term) != ("factor" in term):
            raise DeclarationError(
                f"a term has {'no factor' if 'parameter' in term else 'no parameter'}",
                where=where,
                remedy=_TIE,
            )
        if "parameter" in term:
            _refuse_unknown(term["parameter"], units, where)
            terms.append((term["parameter"], _number(term["factor"], "1", where)))
    if not terms:
        raise DeclarationError(
            "it follows no parameter", where=where, remedy="a constant alone belongs under [fixed]"
        )
    return Tie(name, tuple(terms), constant)


def _bounds(
    table: Any,
    starts: Mapping[str, Any],
    units: Mapping[str, str],
    held: Iterable[str],
    path: str | Path,
) -> Mapping[str, tuple[float, float]]:
    bounds = {}
    for name, pair in _table(
        table, "bounds", path, "write [bounds] with NAME = [low, high]"
    ).items():
        where = f"{path}, key bounds.{name}"
        _refuse_unknown(name, units, where)
        if name in held:
            raise DeclarationError(
                "it is fixed or tied", where=where, remedy="leave its bounds out"
            )
        if not isinstance(pair, list) or len(pair) != 2:
            raise DeclarationError(
                "this is no pair",
                where=where,
                remedy="write [low, high]; inf and -inf leave a side open",
            )
        low, high = (
            float(end)
            if isinstance(end, float) and math.isinf(end)
            else _number(end, units[name], where)
            for end in pair
        )
        if not low < high:
            raise DeclarationError(
                f"{low:g} is not below {high:g}",
                where=where,
                remedy="give the lower bound first; [fixed] holds a parameter",
            )
        if name in starts and not low <= (start := _start(name, starts, units, path)) <= high:
            raise DeclarationError(
                f"the start {start:g} lies outside [{low:g}, {high:g}]",
                where=where,
                remedy="widen the bounds or move the start",
            )
        bounds[name] = (low, high)
    return MappingProxyType(bounds)


def _table(table: Any, key: str, path: str | Path, remedy: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise DeclarationError("this is no table", where=f"{path}, key {key}", remedy=remedy)
    return table


def _refuse_unknown(name: Any, units: Mapping[str, str], where: str) -> None:
    if name not in units:
        raise DeclarationError(
            f"there is no parameter {name!r} to be estimated",
            where=where,
            remedy=closest(str(name), units),
        )


def _refuse_second_entry(name: str, starts: ChainMap[str, Any], where: str) -> None:
    if any(name in table for table in starts.maps[:-1]):
        raise DeclarationError(
            f"given twice, also under {STARTS}", where=where, remedy="keep one of the two"
        )


def _start(
    name: str, starts: Mapping[str, Any], units: Mapping[str, str], path: str | Path
) -> float:
    return _number(starts[name], units[name], f"{path}, key {STARTS}.{name}")


def _number(value: object, unit: str, where: str) -> float:
    from scenarios.files.schemas import number_in

    return number_in(value, unit, where)


# ---- A user's own model

SUFFIX = ".py"
AIRCRAFT_SUFFIX = ".toml"  # a vehicle file of the model ``aircraft`` declares equations, too
# Keys of every vehicle file. A constant with such a name could not be given there.
_RESERVED_KEYS = ("name", STARTS, *TABLES, "uncertainty")
SHORT_PERIOD = ("alpha", "q", "nz")  # outputs that the kinematics of pitching relate
EXAMPLE = "MODEL = own_model(...) as docs/own-models.md shows"


@dataclass(frozen=True, eq=False)
class OwnModel:
    """A user's model at its own starts.

    Attributes
    ----------
    model : the model.
    identity : name and hash of its file; of a model without a file its name and the hash of its
        numbers.
    """

    model: Model
    identity: InputFile


def is_model_file(name: str | OwnModel) -> bool:
    """Return whether ``--model`` names a user's model: a file by its suffix, a path, or a model in
    memory.
    """
    if isinstance(name, OwnModel):
        return True
    return name.endswith((SUFFIX, AIRCRAFT_SUFFIX)) or "/" in name or "\\" in name


def is_own(model: Model) -> bool:
    """Return whether a model is a user model, whose file defines the meaning of its signals."""
    return isinstance(model.equations, UserEquations)


def is_of_aircraft(model: Model) -> bool:
    """Return whether the kinematic checks and the channel names of an aircraft apply to a model.

    They apply to every built-in model, and to a user model that has an airspeed and the outputs of
    the short period in the units of the built-in models.
    """
    if not is_own(model):
        return True
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    airspeed = [item.unit for item in model.parameters if item.name == "airspeed"]
    return airspeed == [CHANNEL_UNITS["airspeed"]] and all(
        units.get(name) == CHANNEL_UNITS[name] for name in SHORT_PERIOD
    )


def inputs_at_rest(model: Model) -> list[float]:
    """Return the inputs of a model at rest, in its order: zero unless its file declares others."""
    equations = model.equations
    declared = equations.inputs_at_rest if isinstance(equations, UserEquations) else {}
    return [declared.get(signal.name, 0.0) for signal in equations.inputs]


def moves_about_rest(model: Model) -> bool:
    """Return whether a model starts at rest, so that modes about its start have a meaning.

    Built-in models do. A user model does if its initial states and its inputs at rest are zero.
    """
    if not is_own(model):
        return True
    return not np.any(model.initial.values()) and not any(inputs_at_rest(model))


def unit_in(model: Model, name: str) -> str:
    """Return the unit of a state, an input, an output or a parameter of a model; 1 for a name that
    the model does not have.
    """
    equations = model.equations
    signals = (*equations.outputs, *equations.inputs, *equations.states, *model.parameters)
    return next((item.unit for item in signals if item.name == name), "1")


def read_user_model(path: str | Path, built_in: tuple[str, ...] = ()) -> OwnModel:
    """Run a user's Python file once and return its ``MODEL``.

    The file's docstring becomes the explanation of the model.

    Parameters
    ----------
    path : the Python file.
    built_in : names that a user's model cannot have.

    Raises
    ------
    DeclarationError : there is no such file; the file has an error (with its line); it has no
        ``MODEL``; ``own_model`` did not make the ``MODEL``; the model has a ``built_in`` name.
    """
    source = read_source(path, DeclarationError, WANTED)
    where = str(source.path)
    module = run_python(source, "model")
    if not hasattr(module, "MODEL"):
        raise DeclarationError(
            "it declares no MODEL", where=where, remedy=f"put {EXAMPLE} at its top level"
        )
    model = checked_model(module.MODEL, where, built_in)
    equations: Any = model.equations
    _refuse_unused(model, equations, source)
    return OwnModel(
        replace(model, equations=replace(equations, explanation=(module.__doc__ or "").strip())),
        source.identity,
    )


def model_in_memory(model: object, built_in: tuple[str, ...] = ()) -> OwnModel:
    """Return a user model that was made in Python without a file.

    Raises DeclarationError as ``read_user_model``.
    """
    checked = checked_model(model, "model", built_in)
    items = (*checked.parameters, *checked.initial)
    numbers = repr([(item.name, item.value, item.unit, item.free) for item in items])
    digest = hashlib.sha256(f"{checked.name}: {numbers}".encode()).hexdigest()
    return OwnModel(checked, InputFile(checked.name, digest))


def checked_model(model: object, where: str, built_in: tuple[str, ...] = ()) -> Model:
    """Return ``model`` if it is a user model with allowed names; else raise DeclarationError."""
    if not isinstance(model, Model) or not is_own(model):
        raise DeclarationError(
            f"its MODEL is of type {type(model).__name__}",
            where=where,
            remedy=f"make it with own_model, {EXAMPLE}",
        )
    if model.name in built_in:
        raise DeclarationError(
            f"the model {model.name!r} is built in", where=where, remedy="give yours another name"
        )
    for name in _RESERVED_KEYS:
        if name in model.parameters and not model.parameters[name].free:
            raise DeclarationError(
                f"a constant {name!r} has no place in a vehicle file",
                where=where,
                remedy="give it another name",
            )
    return model


def _refuse_unused(model: Model, equations: UserEquations, source: Source) -> None:
    """Raise DeclarationError for a parameter that no equation uses, with its line in the file.

    A parameter counts as used if the equations read it at the start of the model, or if the file
    has an attribute of its name: an equation may read it in a branch not taken at the start.
    """
    signals = {
        TIME: 0.0,
        **{item.name: item.value for item in model.initial},
        **{signal.name: 0.0 for signal in (*equations.inputs, *equations.ports)},
        **equations.inputs_at_rest,
    }
    read_at_start = parameters_read(
        equations, TrialPoint(signals, {item.name: item.value for item in model.parameters})
    )
    nodes = [*ast.walk(ast.parse(source.content))]
    attributes = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    for name in model.parameters.free_names:
        if name not in read_at_start and name not in attributes:
            places = (
                f", line {node.lineno}"
                for node in nodes
                if isinstance(node, ast.Constant) and node.value == name
            )
            where = f"{source.path}{next(places, '')}: model {model.name}, parameters, {name}"
            raise DeclarationError(
                "it is in no equation", where=where, remedy="use it, or leave it out"
            )


def own_numbers(own: OwnModel, source: Source) -> tuple[str, Model, Constraints]:
    """Read a vehicle file of a user's model.

    Returns
    -------
    The name of the vehicle; the model with the values of the file, and its own where the file
    omits a value; the constraints of the file, which are not applied to the model yet.

    Raises
    ------
    DeclarationError : the file is not TOML; an unknown key; a value of the wrong kind or unit, or
        beyond its bounds. The message has file, key and remedy in one line.
    """
    path, content = source.path, toml_of(source)
    for key in ("uncertainty", *FLYING_QUALITIES_KEYS):  # `own_vehicle` reads them
        content.pop(key, None)
    free = [item for item in own.model.parameters if item.free]
    constraints = take_constraints(
        content,
        {item.name: item.unit for item in free},
        path,
        {item.name: item.value for item in free},
    )
    name, starts = content.pop("name", path.stem), content.pop(STARTS, {})
    if not isinstance(name, str) or not name:
        raise DeclarationError(
            f"{name!r} is no name", where=f"{path}, key name", remedy='write name = "..."'
        )
    _table(starts, STARTS, path, "write [derivatives], and below it the starts")
    parameters = {item.name: item for item in own.model.parameters}
    values = {}
    for table, is_free, keys in ((content, False, ""), (starts, True, f"{STARTS}.")):
        names = [item.name for item in parameters.values() if item.free is is_free]
        for key, value in table.items():
            where = f"{path}, key {keys}{key}"
            if key not in names:
                raise DeclarationError(
                    "there is no such key",
                    where=where,
                    remedy=_remedy(key, names, free=is_free, misplaced=key in parameters),
                )
            values[key] = _number(value, parameters[key].unit, where)
    try:
        model = own.model.with_values(values)
    except ModelError as error:
        raise DeclarationError(
            f"{error.where}: {error.what}", where=str(path), remedy=error.remedy
        ) from None
    refuse_nothing_left(constraints, [item.name for item in free], path)
    return name, model, constraints


def channel_units(model: Model) -> Mapping[str, str]:
    """Return the unit of every channel that a record for this model may have.

    A user model declares its channels; every other model has the channels of ``CHANNEL_UNITS``.
    """
    if not is_own(model):
        return CHANNEL_UNITS
    signals = (*model.equations.inputs, *model.equations.outputs)
    return {TIME: "s", **{signal.name: signal.unit for signal in signals}}


def _remedy(key: str, allowed: list[str], *, free: bool, misplaced: bool) -> str:
    """Return the remedy for an unknown key of the table of free parameters or of constants.

    ``misplaced``: the key belongs into the other of the two tables.
    """
    if misplaced and free:
        return "it is a constant: put it above [derivatives]"
    if misplaced:
        return "it is a parameter: put it under [derivatives]"
    if allowed:
        return closest(key, allowed)
    return f"the model has no {'parameters' if free else 'constants'}"
