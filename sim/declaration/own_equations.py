"""Equations of motion made of a user's functions, which answer by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb
from typing import Any

from sim.declaration.arguments import NO_CHANGE, ChangedArgument
from sim.declaration.effect import Signal
from sim.errors import FlightidError, ModelError
from sim.maths.elementary import plus

HERE = Path(__file__).parent
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
            return self.formed(s, p)
        except ArithmeticError:
            return dict.fromkeys(self.formed_names, math.nan)
        except Exception as error:
            raise fault(self.name, "flow", self.formed, error, s, p) from None

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
            return [found[signal.name] for signal in signals]
        except ArithmeticError:
            return [math.nan for _ in signals]
        except Exception as error:
            raise fault(self.name, what, function, error, s, p) from None


NO_COMPLEX = "use sin, exp, sqrt, absolute, clip, where and the like of sim.maths.elementary: what stands there must take complex numbers and arrays"


def fault(model: str, what: str, function: Answer, error: Exception, s: Any, p: Any) -> FlightidError:
    """One line on an error that a user's function raised: what, in which function, file and line."""
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


def _changes_argument(error: Exception) -> bool:
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
