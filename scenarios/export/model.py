"""The model of a study, compiled for other programs, and its equations as formulas.

The functions of a `System` are called once with symbols in place of numbers. This gives a list of
operations, each of which occurs once. The list can then be written in any language [1]_.

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
from scenarios.files.vehicles import AIRCRAFT, VEHICLE_FILE_NAME
from scenarios.stored_study import read_stored_study, vehicle_of_study
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
    """A model with the values that a study estimated.

    Attributes
    ----------
    name : name of the vehicle.
    model : name of its equations.
    made_by : command of the study.
    system : compiled model with its values and starting states; SI and radians.
    aircraft : declaration of the aircraft with these values, if the equations are those named
        ``aircraft``; else None.
    remarks : sentences on effects that are written in another form, or left out.
    """

    name: str
    model: str
    made_by: str
    system: System
    aircraft: Aircraft | None = None
    remarks: tuple[str, ...] = field(default=())

    @property
    def identifier(self) -> str:
        """Name of the vehicle in letters, digits and underscores."""
        text = re.sub(r"\W+", "_", self.name, flags=re.ASCII).strip("_")
        return text if text and not text[0].isdigit() else f"model_{text}".rstrip("_")

    def aircraft_for(self, target: str, content: str) -> Aircraft:
        """Return the declaration of the aircraft, for a format that only supports aircraft.

        Parameters
        ----------
        target : word after ``--to``.
        content : what the format holds, such as ``a JSBSim file holds coefficients``; the error
            begins with it.

        Raises
        ------
        DeclarationError : the equations are not those named ``aircraft``.
        """
        if self.aircraft is None:
            raise DeclarationError(
                f"{content}, and this is a study of the model {self.model}",
                where=f"--to {target}",
                remedy="use --to python or --to fmu, or repeat the study with --model aircraft "
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
    """Compile a model with values, and return it for export.

    Effects on inputs and sensors are written as states where they have that form, and left out
    otherwise.

    Parameters
    ----------
    name : name of the vehicle.
    model : the model.
    values : parameter -> value; other parameters keep that of the model.
    starts : state -> starting value.
    aircraft : declaration of the aircraft, if the equations are those named ``aircraft``.
    made_by : command of the study.

    Raises
    ------
    DeclarationError : the model cannot be compiled.
    """
    parameter_names = {item.name for item in model.parameters}
    chosen = {name: value for name, value in (values or {}).items() if name in parameter_names}
    model = model.with_values(chosen)
    states = {item.name for item in model.initial}
    model = model.with_initial(
        model.initial.with_values(
            {name: value for name, value in (starts or {}).items() if name in states}
        )
    )
    remarks: tuple[str, ...] = ()
    try:
        system = compile_model(model)
        if system.input_stages or system.sensor_stages:
            model, remarks = _without_stateless_path_effects(model, system)
            system = compile_model(model, online=True)
            if any(isinstance(effect, OnlineForm) for effect in model.effects):
                remarks = ("Lags of inputs and sensors are written as states.", *remarks)
    except ModelError as error:
        raise DeclarationError(error.what, where="export", remedy=error.remedy) from error
    if aircraft is not None:
        aircraft = aircraft.with_values(chosen)
    return ExportedModel(name, model.name, made_by, system, aircraft, remarks)


def _without_stateless_path_effects(model: Model, system: System) -> tuple[Model, tuple[str, ...]]:
    """Return a model without the effects on the input and sensor paths that have no states, and a
    sentence that names these effects with their values.
    """
    acting = {*system.input_stages, *system.sensor_stages}
    omitted = [
        effect
        for effect in model.effects
        if effect.name in acting and not isinstance(effect, OnlineForm)
    ]
    if not omitted:
        return model, ()
    names = []
    for effect in omitted:
        values = [
            f"{item.name} {model.parameters[full_name(effect, item.name)].value:.4g}"
            + ("" if item.unit in ("1", "-") else f" {item.unit}")
            for item in effect.parameters
        ]
        names.append(f"{effect.name} ({', '.join(values)})" if values else effect.name)
        model = model.without(effect.name)
    return model, (
        f"Left out, since they have no states: {', '.join(names)}; "
        "apply them to the inputs and outputs outside this file.",
    )


def model_of_study(folder: Path, user_model: Path | OwnModel | None = None) -> ExportedModel:
    """Return the model of a study, or that of the vehicle file of an ``aircraft``.

    Parameters
    ----------
    folder : folder of a study of ``identify``, ``diagnose`` or ``structure``, or a vehicle file.
    user_model : Python file of the user's own model, if the study used one; the file is executed.

    Raises
    ------
    DeclarationError : there is no study, or it has no model.
    """
    from scenarios.preparation.declared_model import model_of_file

    if (folder / "structure.json").is_file() and (folder / VEHICLE_FILE_NAME).is_file():
        folder = folder / VEHICLE_FILE_NAME
    if folder.is_file() and folder.suffix == ".toml":
        from scenarios.files.aircraft_files import read_aircraft
        from sim.vehicles.aircraft import aircraft_model

        aircraft, _ = read_aircraft(read_toml_source(folder))
        return exported(aircraft.name, aircraft_model(aircraft), aircraft=aircraft)
    stored_study = read_stored_study(folder)
    vehicle = vehicle_of_study(stored_study, user_model)
    stored = stored_study.model()
    model = model_of_file(vehicle)
    final = stored.after  # the model with the effects that the study found
    if final.effects:
        model = model.with_effects(*final.effects)
    values_per_record = final.own
    starts = {
        name.removesuffix("(0)"): value
        for name, value in (values_per_record[0] if values_per_record else {}).items()
        if name.endswith("(0)")
    }
    declared = None
    if stored.model == AIRCRAFT:
        declared = _aircraft_of(stored.vehicle_text, folder)
    return exported(vehicle.name, model, final.shared, starts, declared, stored.made_by)


def _aircraft_of(text: str, folder: Path) -> Aircraft:
    """Return the aircraft of a vehicle file, from its text in a study."""
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


@dataclass(frozen=True)
class Operation:
    """One operation of an evaluation.

    Attributes
    ----------
    name : ``add``, ``sin``, ``choose``, ``interpolate`` and so on; ``signal`` and ``number`` are
        the leaves.
    arguments : places of its arguments in the list of operations.
    value : number of a leaf ``number``; name of a leaf ``signal``, with ``x:`` before that of a
        state, ``u:`` of an input, ``p:`` of a parameter; ``(knots, values)`` of a table. None for
        other operations.
    """

    name: str
    arguments: tuple[int, ...] = ()
    value: Any = None


class OperationTrace:
    """List of operations in the order of evaluation."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._known: dict[Operation, int] = {}

    def symbol_of(self, operation: Operation) -> Symbol:
        """Return the symbol of an operation; equal operations have one symbol."""
        place = self._known.get(operation)
        if place is None:
            place = self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Symbol(self, place)

    def signal(self, name: str) -> Symbol:
        """Return the symbol of a state, an input or a parameter."""
        return self.symbol_of(Operation("signal", (), name))

    def place_of(self, value: Any) -> int:
        """Return the place of a symbol, or of a number, which is added as a leaf."""
        if isinstance(value, Symbol):
            return value.place
        return self.symbol_of(Operation("number", (), float(value))).place

    def apply(self, name: str, *values: Any) -> Any:
        """Return the result of an operation on symbols and numbers.

        Operations on numbers are computed. Sums with zero, and products with zero or one, are
        simplified.
        """
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
        return self.symbol_of(Operation(name, tuple(self.place_of(value) for value in values)))

    def _number(self, value: Any) -> float | None:
        """Return the number of a value; None for a symbol that is no number."""
        if not isinstance(value, Symbol):
            return float(value)
        result = self.operations[value.place]
        return result.value if result.name == "number" else None


class Symbol(NDArrayOperatorsMixin):
    """Result of an operation in place of a number; functions of NumPy and `sim.maths` take it."""

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
        raise _NoFormula("it decides by the value of a signal with if, and, or, min or max")

    def __float__(self) -> float:
        raise _NoFormula("it makes a plain number of a signal")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        raise _NoFormula("it makes an array of a signal")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        # The only option allowed is `out`, as of a += b; a new symbol is returned either way.
        only_out = set(options) <= {"out"}
        if method != "__call__" or not only_out or ufunc not in _UFUNCS:
            raise _NoFormula(f"it uses numpy.{ufunc.__name__}, for which no formula is written")
        if any(np.ndim(item) for item in inputs if not isinstance(item, Symbol)):
            raise _NoFormula("it joins a signal with an array")
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
        raise _NoFormula(f"it uses numpy.{function.__name__}, for which no formula is written")

    def interpolated(self, knots: Any, values: Any) -> Symbol:
        """Return the value of a table by linear interpolation; it is constant beyond the ends."""
        table = tuple(map(float, knots)), tuple(map(float, values))
        return self.trace.symbol_of(Operation("interpolate", (self.place,), table))


class _NoFormula(TypeError):
    """Error for an equation that cannot be written as a formula."""


@dataclass(frozen=True, eq=False)
class Formulas:
    """The equations of a model as operations.

    Attributes
    ----------
    system : the model.
    operations : operations in the order of evaluation, leaves among them.
    rates, outputs : places of the results, in the order of the states and outputs of the system.
    """

    system: System
    operations: tuple[Operation, ...]
    rates: tuple[int, ...]
    outputs: tuple[int, ...]

    def needed(self, results: Sequence[int]) -> list[int]:
        """Return the places of the operations on which some results depend, in order."""
        needed: set[int] = set()
        remaining = list(results)
        while remaining:
            place = remaining.pop()
            if place not in needed:
                needed.add(place)
                remaining += self.operations[place].arguments
        return sorted(needed)


def formulas_of(system: System) -> Formulas:
    """Return the equations of a system as formulas, with its parameters as symbols.

    Parameters
    ----------
    system : a model without effects on the input path or behind the sensors.

    Raises
    ------
    DeclarationError : the equations branch on values, or use functions without a formula.
    """
    trace = OperationTrace()
    t = trace.signal("t")
    x, u, p = (
        [trace.signal(f"{kind}:{item.name}") for item in items]
        for kind, items in (("x", system.states), ("u", system.inputs), ("p", system.parameters))
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
OperationWriter = Callable[[Operation, Sequence[str]], str]


def statements(
    formulas: Formulas, results: Sequence[int], names: Mapping[str, str], special: OperationWriter
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return assignments ``(variable, formula)`` in order, and the texts of the results.

    Parameters
    ----------
    formulas : the equations.
    results : places of the results.
    names : name of a signal or parameter -> its text in the language.
    special : returns the text of an operation other than a sum, product, quotient or comparison,
        from the texts of its arguments.
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
        arguments = [texts[argument] for argument in operation.arguments]
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
