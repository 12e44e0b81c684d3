"""Equations of motion made of a user's functions, which answer by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np

from sim.declaration.arguments import NO_CHANGE, ChangedArgument
from sim.declaration.effect import Signal
from sim.errors import FlightidError, ModelError, raised_by
from sim.maths.elementary import plus

HERE = Path(__file__).parent
_NUMBERS = frozenset({float, np.float64, complex, np.complex128, int})
Answer = Callable[[Any, Any], Mapping[str, Any]]


@dataclass(frozen=True)
class OwnEquations:
    """Equations of a user's own model, as ``sim.declaration.model.Equations`` wants them.

    ``rates(s, p)``, ``readings(s, p)`` and ``formed(s, p)`` (None where the model forms no further signals, ``formed_names`` else) return
    mappings by name. ``rate_ports`` holds for each state the port that is added to its rate; it is empty where the model declares ports of its
    own, which its functions then take as ``s.PORT``. ``biased_outputs`` names the outputs whose sensors have a free constant bias.
    ``resting``: inputs about which they are tried. ``explanation``: what the file says of the equations.
    ``multiplying``: estimated parameters that multiply signals, with their units. ``products``: port, signal and estimated parameter,
    where the parameter multiplies the signal in a rate to which the port adds.

    A number beyond the range of floats, or a division by zero, makes the answer NaN, which an estimator steps back from; every other error
    in a function is a ModelError that names file and line.
    """

    name: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    ports: tuple[Signal, ...]
    parameter_names: tuple[str, ...]
    rates: Answer
    readings: Answer
    formed: Answer | None = None
    formed_names: tuple[str, ...] = ()
    rate_ports: tuple[str, ...] = ()
    biased_outputs: tuple[str, ...] = ()
    resting: tuple[tuple[str, float], ...] = ()
    explanation: str = ""
    multiplying: tuple[tuple[str, str], ...] = ()
    products: tuple[tuple[str, str, str], ...] = ()

    @property
    def factors(self) -> dict[str, str]:
        """Units of the estimated parameters that multiply signals, by name."""
        return dict(self.multiplying)

    @property
    def resting_inputs(self) -> dict[str, float]:
        """Inputs about which the functions are tried, by name; zero where it says nothing."""
        return dict(self.resting)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        if self.formed is None:
            return {}
        try:
            found = self.formed(s, p)
            answers = {name: found[name] for name in self.formed_names} if self.formed_names else dict(found)
        except ArithmeticError:
            return dict.fromkeys(self.formed_names, math.nan)
        except BaseException as error:
            raise fault(self.name, "flow", self.formed, error, s, p) from None
        self._check_all("flow", self.formed, answers.items(), s, p)
        return answers

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        found = self._answer("rates", self.rates, self.states, s, p)
        if not self.rate_ports:
            return found
        return [plus(rate, getattr(s, port)) for rate, port in zip(found, self.rate_ports, strict=True)]

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return self._answer("readings", self.readings, self.outputs, s, p)

    def _answer(self, what: str, function: Answer, signals: tuple[Signal, ...], s: Any, p: Any) -> list[Any]:
        try:
            found = function(s, p)
            answers = [found[signal.name] for signal in signals]
        except ArithmeticError:
            return [math.nan for _ in signals]
        except BaseException as error:
            raise fault(self.name, what, function, error, s, p) from None
        self._check_all(what, function, zip((each.name for each in signals), answers, strict=True), s, p)
        return answers

    def _check_all(self, what: str, function: Answer, answers: Iterable[tuple[str, Any]], s: Any, p: Any) -> None:
        """Check each answer; plain numbers, and arrays of floats in the shape of the first state, need no second look."""
        shape = getattr(getattr(s, self.states[0].name), "shape", ())
        for name, value in answers:
            kind = type(value)
            if kind in _NUMBERS or (kind is np.ndarray and value.shape == shape and value.dtype.kind in "fc"):
                continue
            self._check(what, function, name, value, s, p)

    def _check(self, what: str, function: Answer, name: str, value: Any, s: Any, p: Any) -> None:
        """Raise ModelError for an answer that is no number, or of a shape that no signal has: it may be another than when it was tried."""
        shape, kind = np.shape(value), getattr(getattr(value, "dtype", None), "kind", None)
        plain = kind in ("f", "c", "i", "u") if kind is not None else isinstance(value, int | complex) and not isinstance(value, bool)
        if plain and (shape == () or shape == np.shape(getattr(s, self.states[0].name))):
            return
        if plain:
            known = {np.shape(each) for each in (*vars(s).values(), *(p if isinstance(p, tuple) else vars(p).values()))}
            if any(shape == each for each in known) or shape == np.broadcast_shapes(*known):
                return
        told = f"of shape {shape} where no signal has it" if plain else f"of type {type(value).__name__}"
        where = written_in(self.name, what, function)
        raise ModelError(f"the answer for {name} is {told}", where=where, remedy="return numbers that go with the signals, in every call")


NO_COMPLEX = "use sin, exp, sqrt, absolute, clip, where and the like of sim.maths.elementary: what stands there must take complex numbers and arrays"


def fault(model: str, what: str, function: Answer, error: BaseException, s: Any, p: Any) -> FlightidError:
    """One line on an error that a user's function raised: what, in which function, file and line.

    What asks the program to stop is raised again: an interrupt from the keyboard, and what is no error of the function.
    """
    if not raised_by(error, getattr(getattr(function, "__code__", None), "co_filename", "")):
        raise error
    if isinstance(error, FlightidError) and not isinstance(error, ChangedArgument):
        return error
    where, text = place(model, what, function, error), " ".join(f"{type(error).__name__}: {error}".split())
    if _changes_argument(error):
        return ModelError("it changes what it was given, s or p, in place", where=where, remedy=NO_CHANGE)
    if isinstance(error, AttributeError) and (error.obj is s or error.obj is p):
        known = [name for name in dir(error.obj) if not name.startswith("_")]
        near = get_close_matches(str(error.name), known, n=1)
        remedy = f"did you mean {near[0]!r}?" if near else f"declare it, or use one of {', '.join(known)}"
        return ModelError(f"there is no {'signal s' if error.obj is s else 'parameter p'}.{error.name}", where=where, remedy=remedy)
    if isinstance(error, KeyError):
        return ModelError(f"{what} gives no {error}", where=where, remedy=f"return a mapping with {error} in it")
    if isinstance(error, TypeError | ValueError):
        return ModelError(text, where=where, remedy=NO_COMPLEX)
    if isinstance(error, ArithmeticError):
        return ModelError(text, where=where, remedy="give starts and `initial` values at which it is a number")
    return ModelError(text, where=where, remedy="mend that line")


def _changes_argument(error: BaseException) -> bool:
    """Whether an error comes of an assignment to a signal or parameter, to an element of one, or to a read-only array."""
    text = str(error)
    return (
        isinstance(error, ChangedArgument)
        or (isinstance(error, ValueError) and "read-only" in text)
        or (isinstance(error, AttributeError) and text.startswith(("can't set", "can't delete")))
        or (isinstance(error, TypeError) and "does not support item" in text)
    )


def written_in(model: str, what: str, function: Callable[..., object]) -> str:
    """``model roll, rates (my_model.py, line 12)``: where the function itself begins."""
    code = getattr(function, "__code__", None)
    return f"model {model}, {what}" + (f" ({code.co_filename}, line {code.co_firstlineno})" if code is not None else "")


def place(model: str, what: str, function: Answer, error: BaseException) -> str:
    """``model roll, rates (my_model.py, line 12)``: the line of the user's file through which the error came last."""
    files = [(frame.f_code.co_filename, line) for frame, line in walk_tb(error.__traceback__)]
    own = getattr(getattr(function, "__code__", None), "co_filename", None)
    lines = [(file, line) for file, line in files if file == own] or [(file, line) for file, line in files if Path(file).parent != HERE]
    return f"model {model}, {what}" + (f" ({lines[-1][0]}, line {lines[-1][1]})" if lines else "")
