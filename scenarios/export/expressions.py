"""The equations of a compiled model as formulas, in the order of their evaluation.

The functions of a `System` are called once with symbols in the place of numbers. Each operation
is noted; what is computed twice is noted once. The list can then be written in any language [1]_.

References
----------
.. [1] A. Griewank and A. Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, section 2.2
   (evaluation traces).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from sim.declaration.model import System
from sim.errors import DeclarationError, FlightidError

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
    """One step of an evaluation.

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
        """The symbol of an operation, the same for the same operation."""
        place = self._known.get(operation)
        if place is None:
            place = self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Symbol(self, place)

    def signal(self, name: str) -> Symbol:
        """The symbol of a state, an input or a parameter."""
        return self.note(Operation("signal", (), name))

    def place_of(self, value: Any) -> int:
        """Place of a symbol, or of a number as a leaf."""
        if isinstance(value, Symbol):
            return value.place
        return self.note(Operation("number", (), float(value))).place

    def apply(self, name: str, *values: Any) -> Any:
        """The result of an operation on symbols and numbers; plain sums and products are
        shortened.
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
        return self.note(Operation(name, tuple(self.place_of(value) for value in values)))

    def _number(self, value: Any) -> float | None:
        if not isinstance(value, Symbol):
            return float(value)
        found = self.operations[value.place]
        return found.value if found.name == "number" else None


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
    """What keeps an equation from being written as a formula."""


@dataclass(frozen=True, eq=False)
class Formulas:
    """The equations of a model as operations.

    Attributes
    ----------
    operations : leaves and steps in order. rates, outputs : places of the results, in the order
        of the system's states and outputs.
    """

    system: System
    operations: tuple[Operation, ...]
    rates: tuple[int, ...]
    outputs: tuple[int, ...]

    def needed(self, results: Sequence[int]) -> list[int]:
        """Places of the operations that lead to some results, in order."""
        wanted: set[int] = set()
        open_ = list(results)
        while open_:
            place = open_.pop()
            if place not in wanted:
                wanted.add(place)
                open_ += self.operations[place].arguments
        return sorted(wanted)


def formulas_of(system: System) -> Formulas:
    """The equations of a system as formulas, with its parameters as symbols.

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
    results : places. names : of signals and parameters, as the language has them.
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
