"""The model of a study, ready to be written for other programs, and the equations of a compiled
model as formulas.

The functions of a `System` are called once with symbols in the place of numbers. Each operation
is noted; what is computed twice is noted once. The list can then be written in any language [1]_.

References
----------
.. [1] A. Griewank and A. Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, section 2.2
   (evaluation traces).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from scenarios.files.declarations import read_toml_source
from scenarios.files.vehicles import AIRCRAFT, BESIDE_RECORD
from scenarios.kept import read_kept
from sim.declaration.compile import compile_model
from sim.declaration.effect import OnlineForm, full_name
from sim.declaration.model import System
from sim.errors import DeclarationError, FlightidError, ModelError

if TYPE_CHECKING:
    from scenarios.files.user_models import OwnModel
    from sim.declaration.model import Model
    from sim.vehicles.aircraft import Aircraft


@dataclass(frozen=True, eq=False)
class ExportedModel:
    """A model with the values that a study found.

    Attributes
    ----------
    name : of the vehicle.
    model : the name of its equations.
    made_by : the command of the study.
    system : compiled, with its values and starting states; SI and radians.
    aircraft : the declaration of a model ``aircraft`` with these values, None of others.
    remarks : sentences on what the written model leaves out.
    """

    name: str
    model: str
    made_by: str
    system: System
    aircraft: Aircraft | None = None
    remarks: tuple[str, ...] = field(default=())

    @property
    def identifier(self) -> str:
        """The vehicle's name in letters, digits and underscores."""
        text = re.sub(r"\W+", "_", self.name, flags=re.ASCII).strip("_")
        return text if text and not text[0].isdigit() else f"model_{text}".rstrip("_")

    def aircraft_for(self, target: str, holds: str) -> Aircraft:
        """Aircraft declaration of the model, for a format that only supports aircraft.

        Parameters
        ----------
        target : of ``--to``.
        holds : first words of the error, on what the format can contain.

        Raises
        ------
        DeclarationError : a model of another kind.
        """
        if self.aircraft is None:
            raise DeclarationError(
                f"{holds}, and this is a study of the model {self.model}",
                where=f"--to {target}",
                remedy="take --to python or fmu, or identify the model aircraft "
                "(flightid structure drafts its vehicle file)",
            )
        return self.aircraft


def exported(
    name: str,
    model: Model,
    values: Mapping[str, float] | None = None,
    starts: Mapping[str, float] | None = None,
    aircraft: Aircraft | None = None,
    made_by: str = "declaration",
) -> ExportedModel:
    """Return a model with values, compiled.

    Parameters
    ----------
    values : of parameters; others keep those of the model.
    starts : of states.
    aircraft : what the model was made of, of a model ``aircraft``.

    Raises
    ------
    DeclarationError : the model cannot be compiled.
    """
    parameter_names = {item.name for item in model.parameters}
    chosen = {name: value for name, value in (values or {}).items() if name in parameter_names}
    model = model.with_values(chosen)
    given = {item.name for item in model.initial}
    model = model.with_initial(
        model.initial.with_values({n: v for n, v in (starts or {}).items() if n in given})
    )
    remarks: tuple[str, ...] = ()
    try:
        system = compile_model(model)
        if system.input_stages or system.sensor_stages:
            model, remarks = _without_whole_record_effects(model, system)
            system = compile_model(model, online=True)
            if any(isinstance(effect, OnlineForm) for effect in model.effects):
                remarks = ("Lags of inputs and sensors are written as states.", *remarks)
    except ModelError as error:
        raise DeclarationError(error.what, where="export", remedy=error.remedy) from error
    if aircraft is not None:
        aircraft = aircraft.with_values(chosen)
    return ExportedModel(name, model.name, made_by, system, aircraft, remarks)


def _without_whole_record_effects(model: Model, system: System) -> tuple[Model, tuple[str, ...]]:
    """Return a model without the effects on inputs and sensors that have no states, and a sentence
    that names them with their values.
    """
    acting = {*system.input_stages, *system.sensor_stages}
    left = [
        effect
        for effect in model.effects
        if effect.name in acting and not isinstance(effect, OnlineForm)
    ]
    if not left:
        return model, ()
    named = []
    for effect in left:
        values = [
            f"{item.name} {model.parameters[full_name(effect, item.name)].value:.4g}"
            + ("" if item.unit in ("1", "-") else f" {item.unit}")
            for item in effect.parameters
        ]
        named.append(f"{effect.name} ({', '.join(values)})" if values else effect.name)
    for effect in left:
        model = model.without(effect.name)
    return model, (
        f"Left out, since they have no states: {', '.join(named)}; "
        "apply them to the inputs and outputs outside this file.",
    )


def model_of_study(folder: Path, user_model: Path | OwnModel | None = None) -> ExportedModel:
    """Return the model that a folder of ``identify`` or ``diagnose`` keeps, that which
    ``structure`` wrote into one, or that of a vehicle file of model ``aircraft``.

    Parameters
    ----------
    folder : of the study, or the file.
    user_model : the study's own model, which is run.

    Raises
    ------
    DeclarationError : no study, or one that keeps no model.
    """
    from scenarios.preparation.declared_model import model_of_file

    if (folder / "structure.json").is_file() and (folder / BESIDE_RECORD).is_file():
        folder = folder / BESIDE_RECORD
    if folder.is_file() and folder.suffix == ".toml":
        from scenarios.files.aircraft_files import read_aircraft
        from sim.vehicles.aircraft import aircraft_model

        aircraft, _ = read_aircraft(read_toml_source(folder))
        return exported(aircraft.name, aircraft_model(aircraft), aircraft=aircraft)
    from scenarios.prediction import vehicle_of_study

    file = read_kept(folder)
    vehicle = vehicle_of_study(file, user_model)
    stored = file.model()
    model = model_of_file(vehicle)
    if stored.after.effects:
        model = model.with_effects(*stored.after.effects)
    starts = {
        key[:-3]: value
        for key, value in (stored.after.own[0] if stored.after.own else {}).items()
        if key.endswith("(0)")
    }
    declared = None
    if stored.model == AIRCRAFT:
        declared = _aircraft_of(stored.vehicle_text, folder)
    return exported(vehicle.name, model, stored.after.shared, starts, declared, stored.made_by)


def _aircraft_of(text: str, folder: Path) -> Aircraft:
    """Return the declaration that a study keeps as text."""
    import tempfile

    from scenarios.files.aircraft_files import read_aircraft

    with tempfile.TemporaryDirectory(prefix="flightid-") as scratch:
        path = Path(scratch) / "vehicle.toml"
        path.write_text(text, encoding="utf-8", newline="\n")
        return read_aircraft(read_toml_source(path))[0]


_UFUNCS: Mapping[Any, str] = {
    np.add: "add",
    np.subtract: "subtract",
    np.multiply: "multiply",
    np.true_divide: "divide",
    np.power: "power",
    np.negative: "negative",
    np.absolute: "abs",
    np.sin: "sin",
    np.cos: "cos",
    np.tan: "tan",
    np.exp: "exp",
    np.log: "log",
    np.sqrt: "sqrt",
    np.tanh: "tanh",
    np.arctan: "atan",
    np.arcsin: "asin",
    np.arcsinh: "asinh",
    np.arctan2: "atan2",
    np.less: "less",
    np.less_equal: "less_equal",
    np.greater: "greater",
    np.greater_equal: "greater_equal",
    np.maximum: "maximum",
    np.minimum: "minimum",
}
_FOLDED: Mapping[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "negative": lambda a: -a,
}
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Operation:
    """One operation of an evaluation.

    Attributes
    ----------
    name : ``add``, ``sin``, ``choose``, ``interpolate`` and so on; ``signal`` and ``number`` are
        the leaves.
    arguments : places of operations before this one.
    value : of a leaf its number or its name, ``x:`` of a state, ``u:`` of an input, ``p:`` of a
        parameter before it; of a table ``(knots, values)``. None else.
    """

    name: str
    arguments: tuple[int, ...] = ()
    value: Any = None


class OperationTrace:
    """Operations in the order in which they were made."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._known: dict[Operation, int] = {}

    def note(self, operation: Operation) -> Symbol:
        """Return the symbol of an operation, the same for the same operation."""
        place = self._known.get(operation)
        if place is None:
            place = self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Symbol(self, place)

    def signal(self, name: str) -> Symbol:
        """Return the symbol of a state, an input or a parameter."""
        return self.note(Operation("signal", (), name))

    def place_of(self, value: Any) -> int:
        """Place of a symbol, or of a number as a leaf."""
        if isinstance(value, Symbol):
            return value.place
        return self.note(Operation("number", (), float(value))).place

    def apply(self, name: str, *values: Any) -> Any:
        """Result of an operation on symbols and numbers; sums and products are simplified."""
        numbers = [self._number(value) for value in values]
        if name in _FOLDED and all(number is not None for number in numbers):
            return _FOLDED[name](*numbers)
        if name in ("add", "subtract", "multiply", "divide"):
            first, second = numbers
            neutral = 1.0 if name in ("multiply", "divide") else 0.0
            if second == neutral:
                return values[0]
            if first == neutral and name in ("add", "multiply"):
                return values[1]
            if 0.0 in (first, second) and name == "multiply":
                return 0.0
        if name == "power" and numbers[1] in (1.0, 2.0):
            return values[0] if numbers[1] == 1.0 else self.apply("multiply", values[0], values[0])
        return self.note(Operation(name, tuple(self.place_of(value) for value in values)))

    def _number(self, value: Any) -> float | None:
        if not isinstance(value, Symbol):
            return float(value)
        result = self.operations[value.place]
        return result.value if result.name == "number" else None


class Symbol(NDArrayOperatorsMixin):
    """A number that is not known yet; NumPy's functions and those of `sim.maths` take it."""

    shape: tuple[int, ...] = ()
    dtype = np.dtype(float)
    __array_priority__ = 1000.0

    def __init__(self, trace: OperationTrace, place: int) -> None:
        self.trace, self.place = trace, place

    @property
    def real(self) -> Symbol:
        """The symbol itself: formulas are real."""
        return self

    def __hash__(self) -> int:
        return hash((id(self.trace), self.place))

    def __bool__(self) -> bool:
        raise _Undecided("it decides by the value of a signal with if, and, or, min or max")

    def __float__(self) -> float:
        raise _Undecided("it makes a plain number of a signal")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        raise _Undecided("it makes an array of a signal")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        in_place = set(options) <= {"out"}  # a += b, which gives a new symbol here
        if method != "__call__" or not in_place or ufunc not in _UFUNCS:
            raise _Undecided(f"it uses numpy.{ufunc.__name__}, for which no formula is written")
        if any(np.ndim(each) for each in inputs if not isinstance(each, Symbol)):
            raise _Undecided("it joins a signal with an array")
        return self.trace.apply(_UFUNCS[ufunc], *inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.where and len(args) == 3:
            return self.trace.apply("choose", *args)
        if function is np.shape:
            return ()
        if function is np.ndim:
            return 0
        if function is np.real:
            return self
        if function is np.clip and len(args) == 3:
            return self.trace.apply("minimum", self.trace.apply("maximum", *args[:2]), args[2])
        raise _Undecided(f"it uses numpy.{function.__name__}, for which no formula is written")

    def interpolated(self, knots: Any, values: Any) -> Symbol:
        """Straight lines between the points of a table, constant beyond them."""
        table = tuple(map(float, knots)), tuple(map(float, values))
        return self.trace.note(Operation("interpolate", (self.place,), table))


class _Undecided(TypeError):
    """Error: an equation cannot be written as a formula."""


@dataclass(frozen=True, eq=False)
class Formulas:
    """The equations of a model as operations.

    Attributes
    ----------
    operations : leaves and steps in order.
    rates, outputs : places of the results, in the order of the system's states and outputs.
    """

    system: System
    operations: tuple[Operation, ...]
    rates: tuple[int, ...]
    outputs: tuple[int, ...]

    def needed(self, results: Sequence[int]) -> list[int]:
        """Return the places of the operations that lead to some results, in order."""
        wanted: set[int] = set()
        open_ = list(results)
        while open_:
            place = open_.pop()
            if place not in wanted:
                wanted.add(place)
                open_ += self.operations[place].arguments
        return sorted(wanted)


def formulas_of(system: System) -> Formulas:
    """Return the equations of a system as formulas, with its parameters as symbols.

    Parameters
    ----------
    system : without effects on the input path or behind the sensors.

    Raises
    ------
    DeclarationError : the equations decide by values, or use functions that no formula is written
        for.
    """
    trace = OperationTrace()
    t = trace.signal("t")
    x, u, p = (
        [trace.signal(f"{kind}:{each.name}") for each in every]
        for kind, every in (("x", system.states), ("u", system.inputs), ("p", system.parameters))
    )
    try:
        rates = [trace.place_of(value) for value in system.f(t, x, u, p)]
        outputs = [trace.place_of(value) for value in system.h(t, x, u, p)]
    except (FlightidError, TypeError, ValueError, AttributeError) as error:
        raise DeclarationError(
            f"the model cannot be written as formulas: {' '.join(str(error).split())}",
            where="export",
            remedy="write its equations with the functions of sim.maths, without arrays",
        ) from None
    for operation in trace.operations:
        if operation.name == "number" and not math.isfinite(operation.value):
            raise DeclarationError(
                "an equation of the model is not finite", where="export", remedy="mend the model"
            )
    return Formulas(system, tuple(trace.operations), tuple(rates), tuple(outputs))


# ---- Formulas as text

_SIGNS = {
    "add": "+",
    "subtract": "-",
    "multiply": "*",
    "divide": "/",
    "less": "<",
    "less_equal": "<=",
    "greater": ">",
    "greater_equal": ">=",
}
Written = Callable[[Operation, Sequence[str]], str]


def statements(
    formulas: Formulas, results: Sequence[int], names: Mapping[str, str], special: Written
) -> tuple[list[tuple[str, str]], list[str]]:
    """Assignments ``(variable, formula)`` in order, and the formulas of the results.

    Parameters
    ----------
    results : places.
    names : of signals and parameters, as the language has them.
    special : writes what is no sum, product, quotient or comparison, from the texts of its
        arguments.
    """
    texts: dict[int, str] = {}
    lines: list[tuple[str, str]] = []
    for place in formulas.needed(results):
        operation = formulas.operations[place]
        if operation.name == "signal":
            texts[place] = names[operation.value]
            continue
        if operation.name == "number":
            texts[place] = (
                repr(operation.value) if operation.value >= 0 else f"({operation.value!r})"
            )
            continue
        arguments = [texts[each] for each in operation.arguments]
        sign = _SIGNS.get(operation.name)
        if sign:
            formula = f"{arguments[0]} {sign} {arguments[1]}"
        elif operation.name == "negative":
            formula = f"-{arguments[0]}"
        else:
            formula = special(operation, arguments)
        texts[place] = f"v{len(lines)}"
        lines.append((texts[place], formula))
    return lines, [texts[place] for place in results]
