"""Equations of motion that a user declares by functions, and trial calls of these functions."""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim.declaration.effect import Signal
from sim.declaration.user_arguments import signals_from, with_locked_arrays
from sim.errors import (
    NO_COMPLEX,
    FlightidError,
    ModelError,
    fault,
    written_in,
)
from sim.maths import COMPLEX_STEP, plus

# ---- Equations of motion from functions of a user, which return mappings by name

_NUMBERS = frozenset({float, np.float64, complex, np.complex128, int})
AnswerFunction = Callable[[Any, Any], Mapping[str, Any]]


@dataclass(frozen=True)
class UserEquations:
    """Equations of a user model, a form of ``sim.declaration.model.Equations``.

    After an overflow or a division by zero the answer is NaN, so that an estimator shortens its
    step. Every other error in a function is a ModelError that names file and line.

    Attributes
    ----------
    rates, readings : functions of ``s`` and ``p`` that return mappings by name.
    flow_function : function of ``s`` and ``p`` that returns the further signals ``flow_names`` by
        name; None if the model has none.
    rate_ports : for each state the port that is added to its rate; empty if the model declares its
        ports itself. Its functions then read them as ``s.PORT``.
    biased_outputs : outputs whose sensors have a free constant bias.
    rest_inputs : name and value of each input whose value at rest is declared. The functions are
        tried at these values.
    explanation : explanation of the equations in the file of the model.
    multiplying_parameters : name and unit of each estimated parameter that multiplies a signal.
    products : (port, signal, estimated parameter), for each parameter that multiplies a signal in
        a rate to which the port is added.
    terms : (coefficient, text) of each term of `sim.aerodynamics`, if the ports are coefficients;
        else empty.
    """

    name: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    ports: tuple[Signal, ...]
    parameter_names: tuple[str, ...]
    rates: AnswerFunction
    readings: AnswerFunction
    flow_function: AnswerFunction | None = None
    flow_names: tuple[str, ...] = ()
    rate_ports: tuple[str, ...] = ()
    biased_outputs: tuple[str, ...] = ()
    rest_inputs: tuple[tuple[str, float], ...] = ()
    explanation: str = ""
    multiplying_parameters: tuple[tuple[str, str], ...] = ()
    products: tuple[tuple[str, str, str], ...] = ()
    terms: tuple[tuple[str, str], ...] = ()

    @property
    def factors(self) -> dict[str, str]:
        """Units of the estimated parameters that multiply signals, by name."""
        return dict(self.multiplying_parameters)

    @property
    def inputs_at_rest(self) -> dict[str, float]:
        """Declared values of inputs at rest, by name. All other inputs are zero at rest."""
        return dict(self.rest_inputs)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        if self.flow_function is None:
            return {}
        try:
            result = self.flow_function(s, p)
            answers = (
                {name: result[name] for name in self.flow_names}
                if self.flow_names
                else dict(result)
            )
        except ArithmeticError:
            return dict.fromkeys(self.flow_names, math.nan)
        except BaseException as error:
            raise fault(self.name, "flow", self.flow_function, error, s, p) from None
        self._check_all("flow", self.flow_function, answers.items(), s, p)
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
        self,
        function_name: str,
        function: AnswerFunction,
        signals: tuple[Signal, ...],
        s: Any,
        p: Any,
    ) -> list[Any]:
        try:
            result = function(s, p)
            answers = [result[signal.name] for signal in signals]
        except ArithmeticError:
            return [math.nan for _ in signals]
        except BaseException as error:
            raise fault(self.name, function_name, function, error, s, p) from None
        self._check_all(
            function_name,
            function,
            zip((each.name for each in signals), answers, strict=True),
            s,
            p,
        )
        return answers

    def _check_all(
        self,
        function_name: str,
        function: AnswerFunction,
        answers: Iterable[tuple[str, Any]],
        s: Any,
        p: Any,
    ) -> None:
        """Raise ModelError for the first bad one of the (name, value) pairs ``answers``.

        To save time, `_check` is not called for numbers, and for float arrays in the shape of the
        first state or in a shape that it has accepted.
        """
        shape = getattr(getattr(s, self.states[0].name), "shape", ())
        accepted_shapes: set[tuple[int, ...]] = set()
        for name, value in answers:
            kind = type(value)
            if kind in _NUMBERS or (
                kind is np.ndarray
                and (value.shape == shape or value.shape in accepted_shapes)
                and value.dtype.kind in "fc"
            ):
                continue
            self._check(function_name, function, name, value, s, p)
            accepted_shapes.add(np.shape(value))

    def _check(
        self, function_name: str, function: AnswerFunction, name: str, value: Any, s: Any, p: Any
    ) -> None:
        """Raise ModelError for an answer that is no number, or whose shape is neither that of a
        signal nor that of a parameter, nor the shape to which all of them broadcast.
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
            f"of shape {shape}, which no signal has"
            if numeric
            else f"of type {type(value).__name__}"
        )
        where = written_in(self.name, function_name, function)
        raise ModelError(
            f"the answer for {name} is {problem}",
            where=where,
            remedy="return in every call a number, or an array of the shape of the signals",
        )


# ---- Trial of a user's functions at the starting values

# Distance from the starting values at which slopes are compared, relative to the value, or absolute
# for a zero. Slopes are not compared at the starts, since many curves have a kink at zero.
TRIAL_OFFSET = 0.01
# step of the central differences, relative to the value, or to ``TRIAL_OFFSET`` for a zero
DIFFERENCE_STEP_SHARE = 1e-6
# rounding error of a difference of two answers, relative to the largest term in an answer; it
# includes three digits for cancellation
TERM_ROUNDING = 1e-12
# largest relative deviation of the slope by differences from the slope by a complex step
SLOPE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class TrialPoint:
    """Point at which a model is tried: values of all signals except those of ``flow``, and of all
    parameters, by name.
    """

    signals: Mapping[str, Any]
    parameters: Mapping[str, Any]


def try_model(equations: UserEquations, starts: TrialPoint) -> tuple[str, ...]:
    """Try a model's functions, and return the names of the signals of ``flow``.

    The functions are evaluated at the starting values, near them with complex steps, and with
    arrays.

    Raises
    ------
    ModelError : if an answer is no mapping, lacks a name, has a name too many or is no finite
        number at the starts; or if a function does not take arrays, or loses the imaginary part of
        a complex step (by ``math``, ``abs`` or ``if`` of a signal).
    """
    values = evaluated(equations, starts)
    for (function_name, name), value in values.items():
        where = written_in(equations.name, function_name, _user_function(equations, function_name))
        if np.shape(value) != ():
            label, shape = _answer_label(function_name, name), np.shape(value)
            problem = f"{label} of shape {shape} where all signals are single numbers"
            raise ModelError(problem, where=where, remedy="return one number for each name")
        if not np.isfinite(value):
            problem = f"{_answer_label(function_name, name)} is {value:g} at the starts"
            raise ModelError(
                problem,
                where=where,
                remedy="give starts and `initial` values at which it is a number",
            )
    for side in (1.0, -1.0):
        _compare_slopes(equations, neighbouring_point(starts, side))
    arrays = TrialPoint(
        *(
            {name: np.array([value, value]) for name, value in values_by_name.items()}
            for values_by_name in (starts.signals, starts.parameters)
        )
    )
    first, second = evaluated(equations, arrays), evaluated(equations, arrays)
    for (function_name, name), value in first.items():
        _refuse_reused_array(
            equations, function_name, name, value, second[function_name, name], arrays
        )
        if np.shape(value) not in ((), (2,)):
            label, shape = _answer_label(function_name, name), np.shape(value)
            problem = f"{label} of shape {shape} where signals have shape (2,)"
            where = written_in(
                equations.name, function_name, _user_function(equations, function_name)
            )
            raise ModelError(
                problem, where=where, remedy="write it so that it broadcasts over arrays"
            )
    if equations.flow_function is None:
        return ()
    return tuple(
        _checked_answer(
            equations,
            "flow",
            equations.flow_function,
            signals_from(starts.signals),
            signals_from(starts.parameters),
        )
    )


def _refuse_reused_array(
    equations: UserEquations,
    function_name: str,
    name: str,
    value: Any,
    second: Any,
    given: TrialPoint,
) -> None:
    """Raise ModelError if the answers ``value`` and ``second`` of two calls are the same array.

    A function that writes into one array at each call would change its earlier answers. Arrays of
    the arguments ``given`` may be returned.
    """
    arguments = [*given.signals.values(), *given.parameters.values()]
    if not isinstance(value, np.ndarray) or any(
        np.shares_memory(value, each) for each in arguments
    ):
        return
    if value.flags.writeable and isinstance(second, np.ndarray) and np.shares_memory(value, second):
        where = written_in(equations.name, function_name, _user_function(equations, function_name))
        raise ModelError(
            f"{_answer_label(function_name, name)} is the same array at every call",
            where=where,
            remedy="return a new array at each call",
        )


def _user_function(equations: UserEquations, function_name: str) -> AnswerFunction:
    """Return the user's function ``rates``, ``readings`` or ``flow``."""
    functions = {"rates": equations.rates, "readings": equations.readings}
    result = functions.get(function_name, equations.flow_function)
    assert result is not None
    return result


class _ReadRecorder(SimpleNamespace):
    """Parameters that record which of them are read, in ``_names_read``."""

    def __getattribute__(self, name: str) -> Any:
        values = object.__getattribute__(self, "__dict__")
        values["_names_read"].add(name)
        return object.__getattribute__(self, name)


def parameters_read(equations: UserEquations, starts: TrialPoint) -> frozenset[str]:
    """Return the names of the parameters that the functions read at the starting values."""
    s, p = signals_from(starts.signals), _ReadRecorder(**starts.parameters, _names_read=set())
    if equations.flow_function is not None:
        s.__dict__.update(_checked_answer(equations, "flow", equations.flow_function, s, p))
    _checked_answer(equations, "rates", equations.rates, s, p)
    _checked_answer(equations, "readings", equations.readings, s, p)
    return frozenset(object.__getattribute__(p, "__dict__")["_names_read"])


@cache
def _parameter_class(names: tuple[str, ...]) -> Any:
    """Return the class of a named tuple of parameters. It is cached, since creating a class is
    slow.
    """
    return namedtuple("Parameters", names)


def evaluated(equations: UserEquations, starts: TrialPoint) -> dict[tuple[str, str], Any]:
    """Return (function, name) -> answer of all functions at a point, checked for names and types.

    Raises
    ------
    ModelError : if an answer is no mapping, lacks a name, has a name too many or is no number.
    """
    s = signals_from(starts.signals)
    p = with_locked_arrays(_parameter_class(tuple(starts.parameters))(**starts.parameters))
    if equations.flow_function is not None:
        result = _checked_answer(equations, "flow", equations.flow_function, s, p)
        for name, value in result.items():
            _refuse_name(equations, name, starts)
            _checked_number(equations, "flow", str(name), value)
        s = signals_from({**starts.signals, **result})
    out: dict[tuple[str, str], Any] = {}
    for function_name, function, signals in (
        ("rates", equations.rates, equations.states),
        ("readings", equations.readings, equations.outputs),
    ):
        result = _checked_answer(equations, function_name, function, s, p)
        names = [signal.name for signal in signals]
        where = written_in(equations.name, function_name, function)
        kind = "state" if function_name == "rates" else "output"
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
        out |= {
            (function_name, name): _checked_number(equations, function_name, name, result[name])
            for name in names
        }
    return out


def _checked_answer(
    equations: UserEquations, function_name: str, function: AnswerFunction, s: Any, p: Any
) -> Mapping[str, Any]:
    """Return the answer of a user's function; raise ModelError if it fails or is no mapping."""
    try:
        result: object = function(s, p)
    except BaseException as error:
        raise fault(equations.name, function_name, function, error, s, p) from error
    if not isinstance(result, Mapping):
        problem = f"it returns a {type(result).__name__}, not a mapping by name"
        raise ModelError(
            problem,
            where=written_in(equations.name, function_name, function),
            remedy='return {"NAME": value, ...}',
        )
    return result


def _refuse_name(equations: UserEquations, name: object, starts: TrialPoint) -> None:
    """Raise ModelError for a signal of ``flow`` whose name is no identifier or is taken."""
    where = written_in(equations.name, "flow", _user_function(equations, "flow"))
    if not isinstance(name, str) or not name.isidentifier():
        raise ModelError(
            f"{name!r} is no name",
            where=where,
            remedy="use letters, digits and underscores",
        )
    if name in starts.signals or name in starts.parameters:
        raise ModelError(
            f"{name} is a signal or parameter already",
            where=where,
            remedy="give the signal of flow another name",
        )


def _checked_number(equations: UserEquations, function_name: str, name: str, value: Any) -> Any:
    """Return the answer ``value``; raise ModelError if it is no number or array of numbers."""
    plain = isinstance(value, int | float | complex | np.number | np.ndarray) and not isinstance(
        value, bool
    )
    if not plain or np.asarray(value).dtype.kind not in "fciu":
        problem = f"{_answer_label(function_name, name)} is of type {type(value).__name__}"
        raise ModelError(
            problem,
            where=written_in(
                equations.name, function_name, _user_function(equations, function_name)
            ),
            remedy="give a number or an array of numbers",
        )
    return value


def _answer_label(function_name: str, name: str) -> str:
    """Return the words for an answer in messages, such as ``the rate of q``."""
    kinds = {"rates": "the rate of", "readings": "the reading of"}
    return f"{kinds.get(function_name, 'the signal')} {name}"


def neighbouring_point(starts: TrialPoint, side: float) -> TrialPoint:
    """Return a point near the starts. Each value is moved by an amount of its own, up for the
    ``side`` 1 and down for -1.
    """

    def moved(values: Mapping[str, Any], phase: int) -> dict[str, Any]:
        amounts = (1.0 + 0.1 * math.sin(phase + i) for i in range(len(values)))
        return {
            name: value + side * TRIAL_OFFSET * amount * (abs(value) or 1.0)
            for (name, value), amount in zip(values.items(), amounts, strict=True)
        }

    return TrialPoint(moved(starts.signals, 1), moved(starts.parameters, 2))


def _compare_slopes(equations: UserEquations, at: TrialPoint) -> None:
    """Raise ModelError if the slopes of the answers by a complex step of a signal or parameter
    differ from those by central differences.

    Nothing is compared where the functions are not finite at the point or beside it.
    """
    names = [(True, name) for name in at.signals if name != "time"]
    names += [(False, name) for name in at.parameters]
    base = _finite_answers(equations, at)
    if base is None:
        return
    step_slopes, differences, steps = [], [], []
    for is_signal, name in names:
        value = (at.signals if is_signal else at.parameters)[name]
        step = DIFFERENCE_STEP_SHARE * (abs(value) or TRIAL_OFFSET)
        stepped = evaluated(equations, changed(at, is_signal, name, complex(value, COMPLEX_STEP)))
        step_slopes.append([np.imag(each) / COMPLEX_STEP for each in stepped.values()])
        sides = [
            _finite_answers(equations, changed(at, is_signal, name, value + sign * step))
            for sign in (1.0, -1.0)
        ]
        differences.append(
            None if sides[0] is None or sides[1] is None else (sides[0] - sides[1]) / (2.0 * step)
        )
        steps.append(step)
    slopes = np.array(step_slopes)
    term_sizes = np.max(
        np.abs(slopes) * np.array(steps)[:, None] / DIFFERENCE_STEP_SHARE, axis=0
    ) + np.abs(base)
    for k, (_, name) in enumerate(names):
        difference = differences[k]
        if difference is None:
            continue
        differs = (
            np.abs(slopes[k] - difference)
            > SLOPE_TOLERANCE * np.maximum(np.abs(slopes[k]), np.abs(difference))
            + TERM_ROUNDING * term_sizes / steps[k]
        )
        if np.any(differs):
            function_name, answer = list(evaluated(equations, at))[int(np.argmax(differs))]
            text = (
                f"{_answer_label(function_name, answer)} loses a complex step of {name}: "
                f"the slope is {difference[differs][0]:.4g}, not {slopes[k][differs][0]:.4g}"
            )
            raise ModelError(
                text,
                where=written_in(
                    equations.name, function_name, _user_function(equations, function_name)
                ),
                remedy=NO_COMPLEX,
            )


def changed(at: TrialPoint, is_signal: bool, name: str, value: Any) -> TrialPoint:
    """Return the point with another value of one signal, or of a parameter if not ``is_signal``."""
    return (
        TrialPoint({**at.signals, name: value}, at.parameters)
        if is_signal
        else TrialPoint(at.signals, {**at.parameters, name: value})
    )


def _finite_answers(equations: UserEquations, at: TrialPoint) -> np.ndarray | None:
    """Return all answers at a point near the starts; None if a function fails or an answer is not
    finite.
    """
    try:
        values: Sequence[Any] = list(evaluated(equations, at).values())
    except FlightidError as error:
        if isinstance(error.__cause__, ArithmeticError | ValueError):
            return None
        raise
    array = np.array(values)
    return array if np.all(np.isfinite(array)) else None
