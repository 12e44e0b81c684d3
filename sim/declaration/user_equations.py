"""Equations of motion from the functions of a user, the arguments of these functions, and trial
calls.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from sim.declaration.effect import Signal
from sim.errors import (
    NO_COMPLEX,
    ChangedArgument,
    FlightidError,
    ModelError,
    fault,
    written_in,
)
from sim.maths import COMPLEX_STEP, plus

# ---- Arguments of users' functions


class Signals(SimpleNamespace):
    """Signals by name, as the attributes of the ``s`` of an equation.

    Attributes cannot be set or deleted. The library itself adds signals through ``__dict__``.
    """

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise ChangedArgument(name)

    def __delattr__(self, name: str) -> NoReturn:
        raise ChangedArgument(name)


def is_sampled(call: int) -> bool:
    """Return whether the arrays of this call (counted from 0) are locked: calls 0, 1, 2, 4, 8 and
    so on.

    Locking in every call would cost 12 to 32 % of the time of an evaluation. A function that
    changes its arguments is found when the model is declared or, if this depends on values, in a
    later call.
    """
    return not call & (call - 1)


def lock_arrays(signals: dict[str, Any]) -> None:
    """Replace each array of a mapping by a read-only view of it."""
    for name, value in signals.items():
        if type(value) is np.ndarray:
            signals[name] = locked(value)


def with_locked_arrays(parameters: Any) -> Any:
    """Return the named tuple with read-only views of its arrays; the same object without arrays."""
    for value in parameters:
        if type(value) is np.ndarray:
            return parameters._make(
                [locked(each) if type(each) is np.ndarray else each for each in parameters]
            )
    return parameters


def locked(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = array.view()
    view.setflags(write=False)
    return view


class WatchedTime(NDArrayOperatorsMixin):
    """Time zero, as a number or an array without axes, that records in ``used`` whether a function
    used it.

    This also detects functions of time whose value changes at a single time only.
    """

    __array_priority__ = 1000.0

    def __init__(self) -> None:
        self.used = False

    def _value(self) -> np.ndarray:
        self.used = True
        return np.zeros(())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._value().astype(dtype or float)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        values = [each._value() if isinstance(each, WatchedTime) else each for each in inputs]
        return getattr(ufunc, method)(*values, **options)

    def __float__(self) -> float:
        return float(self._value())

    def __complex__(self) -> complex:
        return complex(self._value())

    def __bool__(self) -> bool:
        return bool(self._value())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._value(), name)


def signals_from(values: Mapping[str, Any]) -> Signals:
    """Return signals with read-only views of arrays."""
    result = Signals(**values)
    lock_arrays(result.__dict__)
    return result


# ---- Equations of motion from functions of a user, which return mappings by name

_NUMBERS = frozenset({float, np.float64, complex, np.complex128, int})
Answer = Callable[[Any, Any], Mapping[str, Any]]


@dataclass(frozen=True)
class OwnEquations:
    """Equations of a user model, a form of ``sim.declaration.model.Equations``.

    An overflow or a division by zero makes the answer NaN, and an estimator shortens its step.
    Every other error in a function is a ModelError that names file and line.

    Attributes
    ----------
    rates, readings : functions of ``s`` and ``p`` that return mappings by name.
    formed : function that returns further signals, ``formed_names``, by name; None without any.
    rate_ports : the port that is added to the rate of each state; empty if the model declares
        ports of its own, which its functions read as ``s.PORT``.
    biased_outputs : outputs whose sensors have a free constant bias.
    resting : inputs at which the functions are tried, with their values.
    explanation : text of the file on the equations.
    multiplying : estimated parameters that multiply signals, with their units.
    products : (port, signal, estimated parameter): the parameter multiplies the signal in a rate to
        which the port adds.
    terms : coefficient and text of each term, if the ports are coefficients that are sums of terms
        (`sim.aerodynamics`).
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
    terms: tuple[tuple[str, str], ...] = ()

    @property
    def factors(self) -> dict[str, str]:
        """Units of the estimated parameters that multiply signals, by name."""
        return dict(self.multiplying)

    @property
    def resting_inputs(self) -> dict[str, float]:
        """Inputs at which the functions are tried, by name; zero where not declared."""
        return dict(self.resting)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        if self.formed is None:
            return {}
        try:
            result = self.formed(s, p)
            answers = (
                {name: result[name] for name in self.formed_names}
                if self.formed_names
                else dict(result)
            )
        except ArithmeticError:
            return dict.fromkeys(self.formed_names, math.nan)
        except BaseException as error:
            raise fault(self.name, "flow", self.formed, error, s, p) from None
        self._check_all("flow", self.formed, answers.items(), s, p)
        return answers

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        result = self._answer("rates", self.rates, self.states, s, p)
        if not self.rate_ports:
            return result
        return [
            plus(rate, getattr(s, port)) for rate, port in zip(result, self.rate_ports, strict=True)
        ]

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return self._answer("readings", self.readings, self.outputs, s, p)

    def _answer(
        self, what: str, function: Answer, signals: tuple[Signal, ...], s: Any, p: Any
    ) -> list[Any]:
        try:
            result = function(s, p)
            answers = [result[signal.name] for signal in signals]
        except ArithmeticError:
            return [math.nan for _ in signals]
        except BaseException as error:
            raise fault(self.name, what, function, error, s, p) from None
        self._check_all(
            what, function, zip((each.name for each in signals), answers, strict=True), s, p
        )
        return answers

    def _check_all(
        self, what: str, function: Answer, answers: Iterable[tuple[str, Any]], s: Any, p: Any
    ) -> None:
        """Check each answer.

        Numbers, and float arrays in the shape of the first state, are accepted at once.
        """
        shape = getattr(getattr(s, self.states[0].name), "shape", ())
        known: set[tuple[int, ...]] = set()
        for name, value in answers:
            kind = type(value)
            if kind in _NUMBERS or (
                kind is np.ndarray
                and (value.shape == shape or value.shape in known)
                and value.dtype.kind in "fc"
            ):
                continue
            self._check(what, function, name, value, s, p)
            known.add(np.shape(value))

    def _check(self, what: str, function: Answer, name: str, value: Any, s: Any, p: Any) -> None:
        """Raise ModelError for an answer that is no number, or has a shape that no signal has.

        The shape may differ from that of the trial calls.
        """
        shape, kind = np.shape(value), getattr(getattr(value, "dtype", None), "kind", None)
        numeric = (
            kind in ("f", "c", "i", "u")
            if kind is not None
            else isinstance(value, int | complex) and not isinstance(value, bool)
        )
        if numeric and (shape == () or shape == np.shape(getattr(s, self.states[0].name))):
            return
        if numeric:
            known_shapes = {
                np.shape(each)
                for each in (*vars(s).values(), *(p if isinstance(p, tuple) else vars(p).values()))
            }
            if any(shape == each for each in known_shapes) or shape == np.broadcast_shapes(
                *known_shapes
            ):
                return
        problem = (
            f"of shape {shape} where no signal has it"
            if numeric
            else f"of type {type(value).__name__}"
        )
        where = written_in(self.name, what, function)
        raise ModelError(
            f"the answer for {name} is {problem}",
            where=where,
            remedy="return numbers that go with the signals, in every call",
        )


# ---- Trial of a user's functions at the starting values

# Offset from the starts at which slopes are compared, relative to a value (of a zero, to one). Many
# curves have a kink at zero.
TRIAL_OFFSET = 0.01
DIFFERENCE_STEP_SHARE = 1e-6  # step of the differences, relative to a value or ``TRIAL_OFFSET``
# Rounding error of a difference, relative to the terms, with a margin of three digits for
# cancellation.
TERM_ROUNDING = 1e-12
# Largest relative deviation of a difference from the slope by a complex step.
SLOPE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Starts:
    """Point at which a model is tried: all signals except those of ``flow``, and all parameters."""

    signals: Mapping[str, Any]
    parameters: Mapping[str, Any]


def try_model(equations: OwnEquations, starts: Starts) -> tuple[str, ...]:
    """Evaluate a model's functions at the starts, near them with complex steps, and with arrays;
    return the names that ``flow`` forms.

    Raises
    ------
    ModelError : an answer that is no mapping, lacks a name or has one too many, or is no finite
        number at the starts; a function that loses a complex step (``math``, ``abs`` or ``if`` of a
        signal) or does not take arrays.
    """
    values = evaluated(equations, starts)
    for (what, name), value in values.items():
        where = written_in(equations.name, what, _function(equations, what))
        if np.shape(value) != ():
            problem = (
                f"{_answer_label(what, name)} of shape {np.shape(value)} where all signals are "
                "single numbers"
            )
            raise ModelError(problem, where=where, remedy="return one number for each name")
        if not np.isfinite(value):
            problem = f"{_answer_label(what, name)} is {value:g} at the starts"
            raise ModelError(
                problem,
                where=where,
                remedy="give starts and `initial` values at which it is a number",
            )
    for side in (1.0, -1.0):
        _compare_slopes(equations, neighbouring_point(starts, side))
    arrays = Starts(
        *(
            {name: np.array([value, value]) for name, value in some.items()}
            for some in (starts.signals, starts.parameters)
        )
    )
    first, again = evaluated(equations, arrays), evaluated(equations, arrays)
    for (what, name), value in first.items():
        _refuse_reused(equations, what, name, value, again[what, name], arrays)
        if np.shape(value) not in ((), (2,)):
            shape = np.shape(value)
            problem = f"{_answer_label(what, name)} of shape {shape} where signals have shape (2,)"
            where = written_in(equations.name, what, _function(equations, what))
            raise ModelError(
                problem, where=where, remedy="write it so that it broadcasts over arrays"
            )
    if equations.formed is None:
        return ()
    return tuple(
        _checked_answer(
            equations,
            "flow",
            equations.formed,
            signals_from(starts.signals),
            signals_from(starts.parameters),
        )
    )


def _refuse_reused(
    equations: OwnEquations, what: str, name: str, value: Any, again: Any, given: Starts
) -> None:
    """Raise ModelError for an array that a function overwrites at each call.

    Earlier answers would change, too.
    """
    arguments = [*given.signals.values(), *given.parameters.values()]
    if not isinstance(value, np.ndarray) or any(
        np.shares_memory(value, each) for each in arguments
    ):
        return
    if value.flags.writeable and isinstance(again, np.ndarray) and np.shares_memory(value, again):
        where = written_in(equations.name, what, _function(equations, what))
        raise ModelError(
            f"{_answer_label(what, name)} is the same array at every call",
            where=where,
            remedy="return a new array at each call",
        )


def _function(equations: OwnEquations, what: str) -> Answer:
    """Return the user's function of that name."""
    functions = {"rates": equations.rates, "readings": equations.readings}
    result = functions.get(what, equations.formed)
    assert result is not None
    return result


class _ReadRecorder(SimpleNamespace):
    """Parameters that record which of them are read, in ``_names_read``."""

    def __getattribute__(self, name: str) -> Any:
        values = object.__getattribute__(self, "__dict__")
        values["_names_read"].add(name)
        return object.__getattribute__(self, name)


def parameters_read(equations: OwnEquations, starts: Starts) -> frozenset[str]:
    """Return the names of the parameters that the functions read at the starting values."""
    s, p = signals_from(starts.signals), _ReadRecorder(**starts.parameters, _names_read=set())
    if equations.formed is not None:
        s.__dict__.update(_checked_answer(equations, "flow", equations.formed, s, p))
    _checked_answer(equations, "rates", equations.rates, s, p)
    _checked_answer(equations, "readings", equations.readings, s, p)
    return frozenset(object.__getattribute__(p, "__dict__")["_names_read"])


@cache
def _parameter_class(names: tuple[str, ...]) -> Any:
    """Return the class of a named tuple of parameters; creating it takes longer than its use."""
    return namedtuple("Parameters", names)


def evaluated(equations: OwnEquations, starts: Starts) -> dict[tuple[str, str], Any]:
    """Return all answers at a point by function and name, checked for names and types.

    Raises
    ------
    ModelError : an answer that is no mapping, lacks a name or has one too many, or is no number.
    """
    s = signals_from(starts.signals)
    p = with_locked_arrays(_parameter_class(tuple(starts.parameters))(**starts.parameters))
    if equations.formed is not None:
        result = _checked_answer(equations, "flow", equations.formed, s, p)
        for name, value in result.items():
            _refuse_name(equations, name, starts)
            _number(equations, "flow", str(name), value)
        s = signals_from({**starts.signals, **result})
    out: dict[tuple[str, str], Any] = {}
    for what, function, signals in (
        ("rates", equations.rates, equations.states),
        ("readings", equations.readings, equations.outputs),
    ):
        result = _checked_answer(equations, what, function, s, p)
        names = [signal.name for signal in signals]
        where = written_in(equations.name, what, function)
        kind = "state" if what == "rates" else "output"
        for name in result:
            if name not in names:
                raise ModelError(
                    f"there is no {kind} {name!r}",
                    where=where,
                    remedy=f"the {kind}s are {', '.join(names)}",
                )
        missing = [name for name in names if name not in result]
        if missing:
            raise ModelError(
                f"{', '.join(missing)} missing",
                where=where,
                remedy=f"return one value for each {kind}",
            )
        out |= {(what, name): _number(equations, what, name, result[name]) for name in names}
    return out


def _checked_answer(
    equations: OwnEquations, what: str, function: Answer, s: Any, p: Any
) -> Mapping[str, Any]:
    try:
        result: object = function(s, p)
    except BaseException as error:
        raise fault(equations.name, what, function, error, s, p) from error
    if not isinstance(result, Mapping):
        shown = f"it returns a {type(result).__name__}, not a mapping by name"
        raise ModelError(
            shown,
            where=written_in(equations.name, what, function),
            remedy='return {"NAME": value, ...}',
        )
    return result


def _refuse_name(equations: OwnEquations, name: object, starts: Starts) -> None:
    where = written_in(equations.name, "flow", _function(equations, "flow"))
    if not isinstance(name, str) or not name.isidentifier():
        raise ModelError(
            f"{name!r} is no name", where=where, remedy="use letters, digits and underscores"
        )
    if name in starts.signals or name in starts.parameters:
        raise ModelError(
            f"{name} is a signal or parameter already",
            where=where,
            remedy="give the signal of flow another name",
        )


def _number(equations: OwnEquations, what: str, name: str, value: Any) -> Any:
    plain = isinstance(value, int | float | complex | np.number | np.ndarray) and not isinstance(
        value, bool
    )
    if not plain or np.asarray(value).dtype.kind not in "fciu":
        problem = f"{_answer_label(what, name)} is of type {type(value).__name__}"
        raise ModelError(
            problem,
            where=written_in(equations.name, what, _function(equations, what)),
            remedy="give a number or an array of numbers",
        )
    return value


def _answer_label(what: str, name: str) -> str:
    kinds = {"rates": "the rate of", "readings": "the reading of"}
    return f"{kinds.get(what, 'the signal')} {name}"


def neighbouring_point(starts: Starts, side: float) -> Starts:
    """Return a point near the starts, each value moved by a different amount."""

    def moved(some: Mapping[str, Any], first: int) -> dict[str, Any]:
        amounts = (1.0 + 0.1 * math.sin(first + i) for i in range(len(some)))
        return {
            name: value + side * TRIAL_OFFSET * amount * (abs(value) or 1.0)
            for (name, value), amount in zip(some.items(), amounts, strict=True)
        }

    return Starts(moved(starts.signals, 1), moved(starts.parameters, 2))


def _compare_slopes(equations: OwnEquations, at: Starts) -> None:
    """Raise ModelError if the slopes by complex steps and by differences disagree for a signal or
    parameter.

    Points at which the functions are not finite are skipped.
    """
    names = [(True, name) for name in at.signals if name != "time"]
    names += [(False, name) for name in at.parameters]
    base = _finite(equations, at)
    if base is None:
        return
    exact, result, steps = [], [], []
    for of_signal, name in names:
        value = (at.signals if of_signal else at.parameters)[name]
        step = DIFFERENCE_STEP_SHARE * (abs(value) or TRIAL_OFFSET)
        stepped = evaluated(equations, changed(at, of_signal, name, complex(value, COMPLEX_STEP)))
        exact.append([np.imag(each) / COMPLEX_STEP for each in stepped.values()])
        sides = [
            _finite(equations, changed(at, of_signal, name, value + sign * step))
            for sign in (1.0, -1.0)
        ]
        result.append(
            None if sides[0] is None or sides[1] is None else (sides[0] - sides[1]) / (2.0 * step)
        )
        steps.append(step)
    slopes = np.array(exact)
    terms = np.max(
        np.abs(slopes) * np.array(steps)[:, None] / DIFFERENCE_STEP_SHARE, axis=0
    ) + np.abs(base)
    for k, (_, name) in enumerate(names):
        difference = result[k]
        if difference is None:
            continue
        differs = (
            np.abs(slopes[k] - difference)
            > SLOPE_TOLERANCE * np.maximum(np.abs(slopes[k]), np.abs(difference))
            + TERM_ROUNDING * terms / steps[k]
        )
        if np.any(differs):
            what, answer = list(evaluated(equations, at))[int(np.argmax(differs))]
            text = (
                f"{_answer_label(what, answer)} loses a complex step of {name}: the slope is "
                f"{difference[differs][0]:.4g}, not {slopes[k][differs][0]:.4g}"
            )
            raise ModelError(
                text,
                where=written_in(equations.name, what, _function(equations, what)),
                remedy=NO_COMPLEX,
            )


def changed(at: Starts, of_signal: bool, name: str, value: Any) -> Starts:
    """Return the point with another value of one signal or parameter."""
    return (
        Starts({**at.signals, name: value}, at.parameters)
        if of_signal
        else Starts(at.signals, {**at.parameters, name: value})
    )


def _finite(equations: OwnEquations, at: Starts) -> np.ndarray | None:
    """Return all answers at a point near the starts, None if one is not finite or fails."""
    try:
        values: Sequence[Any] = list(evaluated(equations, at).values())
    except FlightidError as error:
        if isinstance(error.__cause__, ArithmeticError | ValueError):
            return None
        raise
    array = np.array(values)
    return array if np.all(np.isfinite(array)) else None
