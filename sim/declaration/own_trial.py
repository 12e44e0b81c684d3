"""A user's functions tried once at the starts: what they answer, and whether complex numbers and arrays pass through them."""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim.declaration.arguments import signals_from, with_locked_arrays
from sim.declaration.own_equations import NO_COMPLEX, Answer, OwnEquations, fault, written_in
from sim.errors import FlightidError, ModelError
from sim.maths.elementary import COMPLEX_STEP

ASIDE = 0.01  # of a value, or of one: how far beside the starts slopes are compared, since at zero itself many curves have a kink
DIFFERENCE = 1e-6  # of a value, or of ``ASIDE``: step of the differences
TERMS = 1e-12  # of the sizes of the terms: rounding of a difference, with three digits to spare for what cancels inside
SLOPE = 1e-3  # by which a difference and a complex step may be apart: a curve as sharp as the step of a difference is no curve


@dataclass(frozen=True)
class Starts:
    """Where a model is tried: every signal on the bus but those of ``flow``, and every parameter."""

    signals: Mapping[str, Any]
    parameters: Mapping[str, Any]


def try_model(equations: OwnEquations, starts: Starts) -> tuple[str, ...]:
    """Evaluate a model's functions at the starts, beside them with complex steps, and with arrays; the names that ``flow`` forms.

    Raises
    ------
    ModelError : an answer that is no mapping, lacks a name or has one too many, or is no finite number at the starts; a function that loses a
        complex step (``math``, ``abs`` or ``if`` of a signal) or does not take arrays.
    """
    values = evaluated(equations, starts)
    for (what, name), value in values.items():
        where = written_in(equations.name, what, _function(equations, what))
        if np.shape(value) != ():
            told = f"{_told(what, name)} of shape {np.shape(value)} where all signals are single numbers"
            raise ModelError(told, where=where, remedy="return one number for each name")
        if not np.isfinite(value):
            told = f"{_told(what, name)} is {value:g} at the starts"
            raise ModelError(told, where=where, remedy="give starts and `initial` values at which it is a number")
    for side in (1.0, -1.0):
        _compare_slopes(equations, beside(starts, side))
    arrays = Starts(*({name: np.array([value, value]) for name, value in some.items()} for some in (starts.signals, starts.parameters)))
    first, again = evaluated(equations, arrays), evaluated(equations, arrays)
    for (what, name), value in first.items():
        _refuse_reused(equations, what, name, value, again[what, name], arrays)
        if np.shape(value) not in ((), (2,)):
            told = f"{_told(what, name)} of shape {np.shape(value)} where signals have shape (2,)"
            where = written_in(equations.name, what, _function(equations, what))
            raise ModelError(told, where=where, remedy="write it so that it broadcasts over arrays")
    if equations.formed is None:
        return ()
    return tuple(_asked(equations, "flow", equations.formed, signals_from(starts.signals), signals_from(starts.parameters)))


def _refuse_reused(equations: OwnEquations, what: str, name: str, value: Any, again: Any, given: Starts) -> None:
    """Raise ModelError for an array that a function makes once and overwrites at each call: earlier answers would change with it."""
    arguments = [*given.signals.values(), *given.parameters.values()]
    if not isinstance(value, np.ndarray) or any(np.shares_memory(value, each) for each in arguments):
        return
    if value.flags.writeable and isinstance(again, np.ndarray) and np.shares_memory(value, again):
        where = written_in(equations.name, what, _function(equations, what))
        raise ModelError(f"{_told(what, name)} is the same array at every call", where=where, remedy="return a new array at each call")


def _function(equations: OwnEquations, what: str) -> Answer:
    """The user's function of that name."""
    found = {"rates": equations.rates, "readings": equations.readings, "flow": equations.formed}[what]
    assert found is not None
    return found


class _Noting(SimpleNamespace):
    """Parameters that note which of them are asked for."""

    def __getattribute__(self, name: str) -> Any:
        values = object.__getattribute__(self, "__dict__")
        values["_asked"].add(name)
        return object.__getattribute__(self, name)


def parameters_asked(equations: OwnEquations, starts: Starts) -> frozenset[str]:
    """Names of the parameters that the functions ask for when they are evaluated at the starts."""
    s, p = signals_from(starts.signals), _Noting(**starts.parameters, _asked=set())
    if equations.formed is not None:
        s.__dict__.update(_asked(equations, "flow", equations.formed, s, p))
    _asked(equations, "rates", equations.rates, s, p)
    _asked(equations, "readings", equations.readings, s, p)
    return frozenset(object.__getattribute__(p, "__dict__")["_asked"])


def evaluated(equations: OwnEquations, starts: Starts) -> dict[tuple[str, str], Any]:
    """All answers at some signals and parameters by function and name, checked for names and kinds.

    Raises
    ------
    ModelError : an answer that is no mapping, lacks a name or has one too many, or is no number.
    """
    s = signals_from(starts.signals)
    p = with_locked_arrays(namedtuple("Parameters", starts.parameters)(**starts.parameters))
    if equations.formed is not None:
        found = _asked(equations, "flow", equations.formed, s, p)
        for name, value in found.items():
            _refuse_name(equations, name, starts)
            _number(equations, "flow", str(name), value)
        s = signals_from({**starts.signals, **found})
    out: dict[tuple[str, str], Any] = {}
    for what, function, signals in (("rates", equations.rates, equations.states), ("readings", equations.readings, equations.outputs)):
        found, known = _asked(equations, what, function, s, p), [signal.name for signal in signals]
        where, kind = written_in(equations.name, what, function), "state" if what == "rates" else "output"
        for name in found:
            if name not in known:
                raise ModelError(f"there is no {kind} {name!r}", where=where, remedy=f"the {kind}s are {', '.join(known)}")
        missing = [name for name in known if name not in found]
        if missing:
            raise ModelError(f"{', '.join(missing)} missing", where=where, remedy=f"return one value for each {kind}")
        out |= {(what, name): _number(equations, what, name, found[name]) for name in known}
    return out


def _asked(equations: OwnEquations, what: str, function: Answer, s: Any, p: Any) -> Mapping[str, Any]:
    try:
        found: object = function(s, p)
    except BaseException as error:
        raise fault(equations.name, what, function, error, s, p) from error
    if not isinstance(found, Mapping):
        shown = f"it returns a {type(found).__name__}, not a mapping by name"
        raise ModelError(shown, where=written_in(equations.name, what, function), remedy='return {"NAME": value, ...}')
    return found


def _refuse_name(equations: OwnEquations, name: object, starts: Starts) -> None:
    where = written_in(equations.name, "flow", _function(equations, "flow"))
    if not isinstance(name, str) or not name.isidentifier():
        raise ModelError(f"{name!r} is no name", where=where, remedy="use letters, digits and underscores")
    if name in starts.signals or name in starts.parameters:
        raise ModelError(f"{name} is a signal or parameter already", where=where, remedy="give what flow forms a name of its own")


def _number(equations: OwnEquations, what: str, name: str, value: Any) -> Any:
    plain = isinstance(value, int | float | complex | np.number | np.ndarray) and not isinstance(value, bool)
    if not plain or np.asarray(value).dtype.kind not in "fciu":
        told = f"{_told(what, name)} is of type {type(value).__name__}"
        raise ModelError(told, where=written_in(equations.name, what, _function(equations, what)), remedy="give a number or an array of numbers")
    return value


def _told(what: str, name: str) -> str:
    return f"the {'rate' if what == 'rates' else 'reading' if what == 'readings' else 'signal'} of {name}".replace("signal of", "signal")


def beside(starts: Starts, side: float) -> Starts:
    """A point beside the starts, each value moved by another amount."""

    def moved(some: Mapping[str, Any], first: int) -> dict[str, Any]:
        amounts = (1.0 + 0.1 * math.sin(first + i) for i in range(len(some)))
        return {name: value + side * ASIDE * amount * (abs(value) or 1.0) for (name, value), amount in zip(some.items(), amounts, strict=True)}

    return Starts(moved(starts.signals, 1), moved(starts.parameters, 2))


def _compare_slopes(equations: OwnEquations, at: Starts) -> None:
    """Complex steps against differences, one signal and parameter after the other; nothing where the functions have no finite values there."""
    names = [(True, name) for name in at.signals if name != "time"] + [(False, name) for name in at.parameters]
    base = _finite(equations, at)
    if base is None:
        return
    exact, found, steps = [], [], []
    for of_signal, name in names:
        value = (at.signals if of_signal else at.parameters)[name]
        step = DIFFERENCE * (abs(value) or ASIDE)
        stepped = evaluated(equations, changed(at, of_signal, name, complex(value, COMPLEX_STEP)))
        exact.append([np.imag(each) / COMPLEX_STEP for each in stepped.values()])
        sides = [_finite(equations, changed(at, of_signal, name, value + sign * step)) for sign in (1.0, -1.0)]
        found.append(None if sides[0] is None or sides[1] is None else (sides[0] - sides[1]) / (2.0 * step))
        steps.append(step)
    slopes = np.array(exact)
    terms = np.max(np.abs(slopes) * np.array(steps)[:, None] / DIFFERENCE, axis=0) + np.abs(base)
    for k, (_, name) in enumerate(names):
        difference = found[k]
        if difference is None:
            continue
        apart = np.abs(slopes[k] - difference) > SLOPE * np.maximum(np.abs(slopes[k]), np.abs(difference)) + TERMS * terms / steps[k]
        if np.any(apart):
            what, answer = list(evaluated(equations, at))[int(np.argmax(apart))]
            told = f"{_told(what, answer)} loses a complex step of {name}: the slope is {difference[apart][0]:.4g}, not {slopes[k][apart][0]:.4g}"
            raise ModelError(told, where=written_in(equations.name, what, _function(equations, what)), remedy=NO_COMPLEX)


def changed(at: Starts, of_signal: bool, name: str, value: Any) -> Starts:
    """The same with another value of one signal, or of one parameter."""
    return Starts({**at.signals, name: value}, at.parameters) if of_signal else Starts(at.signals, {**at.parameters, name: value})


def _finite(equations: OwnEquations, at: Starts) -> np.ndarray | None:
    """All answers at a point beside the starts, None where one is not finite or cannot be formed."""
    try:
        values: Sequence[Any] = list(evaluated(equations, at).values())
    except FlightidError as error:
        if isinstance(error.__cause__, ArithmeticError | ValueError):
            return None
        raise
    array = np.array(values)
    return array if np.all(np.isfinite(array)) else None
