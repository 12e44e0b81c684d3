"""A user model: named states, inputs, outputs and parameters with units, and functions that return
its equations.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from numbers import Real
from typing import Any

import numpy as np

from sim.declaration.effect import Parameter, ParameterSet, Signal
from sim.declaration.model import Model
from sim.declaration.user_arguments import Signals
from sim.declaration.user_equations import (
    TRIAL_OFFSET,
    AnswerFunction,
    TrialPoint,
    UserEquations,
    changed,
    evaluated,
    neighbouring_point,
    try_model,
)
from sim.errors import FlightidError, ModelError, written_in
from sim.maths import COMPLEX_STEP, complex_step_jacobian

# ---- Signals that parameters of a user model multiply

TrialAnswer = tuple[str, str]  # "rates" or "readings", and the name of the state or output
SLOPE_TOLERANCE = 1e-9  # difference of slopes due to rounding, relative to the largest slope


def multiplying(
    equations: UserEquations, starts: TrialPoint, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the parameters of ``names`` that multiply signals.

    The slope of the rates and readings by such a parameter depends on the signals. A parameter that
    is only added, such as a constant load, has the same slope everywhere.
    """
    places = [
        TrialPoint(neighbouring_point(starts, side).signals, starts.parameters)
        for side in (0.0, 1.0, -0.6)
    ]
    result = []
    for name in names:
        slopes = [_slopes(equations, at, False, name) for at in places]
        if all(slopes) and any(_differ([each[answer] for each in slopes]) for answer in slopes[0]):
            result.append(name)
    return tuple(result)


def products(
    equations: UserEquations, starts: TrialPoint, names: Sequence[str]
) -> tuple[tuple[str, str, str], ...]:
    """Return (port, signal, parameter) for each parameter of ``names`` that multiplies a signal in
    a rate to which the port adds.

    A parameter multiplies a signal if the slope by the parameter differs at two values of the
    signal.
    """
    here = neighbouring_point(starts, 1.0)
    fed = _rates_fed(equations, here)
    base = {name: _slopes(equations, here, False, name) for name in names}
    result = []
    for signal in (*equations.states, *equations.inputs):
        value = here.signals[signal.name]
        moved = changed(here, True, signal.name, value + TRIAL_OFFSET * (abs(value) or 1.0))
        for name in names:
            there = _slopes(equations, moved, False, name)
            rates = {
                a
                for a, slope in base[name].items()
                if a in there and a[0] == "rates" and _differ([slope, there[a]])
            }
            result += [
                (port, signal.name, name) for port, reached in fed.items() if rates & reached
            ]
    return tuple(result)


def _rates_fed(equations: UserEquations, at: TrialPoint) -> dict[str, set[TrialAnswer]]:
    """Return the rates that each port adds to."""
    if equations.rate_ports:
        return {
            port: {("rates", state.name)}
            for port, state in zip(equations.rate_ports, equations.states, strict=True)
        }
    slopes = {port.name: _slopes(equations, at, True, port.name) for port in equations.ports}
    return {
        port: {answer for answer, slope in result.items() if answer[0] == "rates" and slope != 0.0}
        for port, result in slopes.items()
    }


def _slopes(
    equations: UserEquations, at: TrialPoint, is_signal: bool, name: str
) -> dict[TrialAnswer, float]:
    """Return the slopes of all rates and readings by one signal or parameter; empty if the
    functions fail.
    """
    value = (at.signals if is_signal else at.parameters)[name]
    try:
        result = evaluated(equations, changed(at, is_signal, name, complex(value, COMPLEX_STEP)))
    except FlightidError:
        return {}
    return {answer: float(np.imag(each)) / COMPLEX_STEP for answer, each in result.items()}


def _differ(slopes: Sequence[float]) -> bool:
    return bool(np.ptp(slopes) > SLOPE_TOLERANCE * np.max(np.abs(slopes)))


# ---- Observable sensor biases of a user model

LARGEST_SCALE_FACTOR = 2.0  # largest scale factor of a sensor that reads a state
# Share of the largest singular value below which a direction is unobservable.
UNOBSERVABLE_SHARE = 1e-9


def observable_biases(equations: UserEquations, starts: TrialPoint) -> tuple[str, ...]:
    """Return the outputs whose bias is observable together with free initial states, in order.

    With A and C the slopes of rates and readings by the states, a bias is unobservable if C x0
    equals it for a constant change x0 of the states with A x0 = 0. Slopes are taken at points on
    both sides of the starting values. A bias counts as observable if it is observable at one of
    them.
    """
    observable = [
        _observable(*_state_slopes(equations, neighbouring_point(starts, side)))
        for side in (1.0, -1.0)
    ]
    return tuple(
        signal.name
        for i, signal in enumerate(equations.outputs)
        if any(i in some for some in observable)
    )


def refuse_misnamed(equations: UserEquations, starts: TrialPoint) -> None:
    """Raise ModelError for an output that has the name of a state but does not read it."""
    states = [signal.name for signal in equations.states]
    both = [
        (i, states.index(signal.name))
        for i, signal in enumerate(equations.outputs)
        if signal.name in states
    ]
    points = [neighbouring_point(starts, side) for side in (1.0, -1.0)] if both else []
    slopes = [_state_slopes(equations, point)[1] for point in points]
    for i, j in both:
        output, state = equations.outputs[i], equations.states[j]
        where = f"model {equations.name}, outputs, {output.name}"
        if output.unit != state.unit:
            remedy = "give it the state's unit (a record's columns are converted), or another name"
            raise ModelError(
                f"the unit is {output.unit}, that of the state of this name {state.unit}",
                where=where,
                remedy=remedy,
            )
        if not any(
            1.0 / LARGEST_SCALE_FACTOR < C[i, j] < LARGEST_SCALE_FACTOR or not np.isfinite(C[i, j])
            for C in slopes
        ):
            raise ModelError(
                "it has the name of a state and reads something else (it moves "
                f"{slopes[0][i, j]:.3g} times as far)",
                where=where,
                remedy="give it another name, or read the state as it is",
            )


def _state_slopes(equations: UserEquations, at: TrialPoint) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes by the states at a point: A ``(n, n)`` of rates, C ``(m, n)`` of readings."""
    names, p = [signal.name for signal in equations.states], Signals(**at.parameters)

    def answers(x: Sequence[Any]) -> list[Any]:
        s = Signals(**{**at.signals, **dict(zip(names, x, strict=True))})
        s.__dict__.update(equations.flow(s, p))
        return [*equations.derivatives(s, p), *equations.measurements(s, p)]

    both = complex_step_jacobian(answers, [at.signals[name] for name in names])
    return both[: len(names)], both[len(names) :]


def _observable(A: np.ndarray, C: np.ndarray) -> list[int]:
    """Return the positions of the outputs with an observable bias; all if slopes are not finite."""
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(C))):
        return list(range(len(C)))
    sizes = np.max(np.abs(C), axis=1, keepdims=True)
    C = C / np.where(sizes > 0.0, sizes, 1.0)
    chosen: list[int] = []
    for i in range(len(C)):
        if _observability_rank(A, C, [*chosen, i]) > _observability_rank(A, C, chosen):
            chosen.append(i)
    return chosen


def _observability_rank(A: np.ndarray, C: np.ndarray, biases: Sequence[int]) -> int:
    """Return the rank of the observability matrix with the states and these biases as unknowns.

    Time is scaled, which does not change the rank.
    """
    n, k = len(A), len(biases)
    rate = np.linalg.norm(A, 2)
    step = np.zeros((n + k, n + k))
    step[:n, :n] = A / rate if rate > 0.0 else A
    row = np.hstack([C, np.eye(len(C))[:, biases]])
    rows = [row]
    for _ in range(n + k - 1):
        rows.append(rows[-1] @ step)
    return int(np.linalg.matrix_rank(np.vstack(rows), rtol=UNOBSERVABLE_SHARE))


# ---- The declaration of a user model

Units = Mapping[str, str]
Numbers = Mapping[str, tuple[float, str]]

TIME = "time"
BIAS = "bias_"  # prefix of the parameter of a sensor's bias


def own_model(
    name: str,
    states: Units,
    inputs: Units,
    outputs: Units,
    parameters: Numbers,
    rates: AnswerFunction,
    readings: AnswerFunction,
    constants: Numbers | None = None,
    ports: Units | None = None,
    flow: AnswerFunction | None = None,
    initial: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    biases: Collection[str] | None = None,
) -> Model:
    """Build a model from mappings by name and functions of ``s`` and ``p``.

    ``s`` has the signals as attributes: states, inputs, ports, ``time`` (s) and those of ``flow``.
    ``p`` has the parameters and constants. Values are numbers, complex numbers or arrays; use the
    functions of ``sim.maths``.

    Parameters
    ----------
    name : name of the model in tables and messages.
    states, inputs, outputs : name -> unit. An output with the name of a state reads that state.
    parameters : name -> (starting value, unit), estimated.
    constants : name -> (value, unit), fixed.
    rates : ``rates(s, p)`` returns the rate of each state by name, in its unit per second.
    readings : ``readings(s, p)`` returns each output by name.
    ports : name -> unit of disturbances, zero unless an effect adds to them, read as ``s.PORT``;
        None for one port ``STATE_rate`` for each state, added to its rate.
    flow : ``flow(s, p)`` returns further signals by name, computed once for both other functions.
    initial : name -> initial value of a state, else zero; of an input, its value in the trial.
    bounds : name of a parameter -> (lowest, highest).
    biases : outputs whose sensors have a free constant bias; None for all whose bias is observable
        together with the initial states.

    Raises
    ------
    ModelError : a declaration is wrong, or a function fails at the starting values.

    Examples
    --------
    >>> from sim.declaration.user_model import own_model
    >>> model = own_model(
    ...     name="antenna",
    ...     states={"angle": "rad", "rate": "rad/s"},
    ...     inputs={"current": "A"},
    ...     outputs={"angle": "rad"},
    ...     parameters={"gain": (1.5, "N m/A"), "friction": (3.0, "N m s/rad")},
    ...     constants={"inertia": (4.0, "kg m2")},
    ...     rates=lambda s, p: {
    ...         "angle": s.rate,
    ...         "rate": (p.gain * s.current - p.friction * s.rate) / p.inertia,
    ...     },
    ...     readings=lambda s, p: {"angle": s.angle},
    ... )
    >>> model.name
    'antenna'
    """
    functions = {"rates": rates, "readings": readings, **({} if flow is None else {"flow": flow})}
    _refuse_title(name)
    _refuse_uncallable(name, functions)
    signals = _declared_signals(name, states, inputs, outputs, ports)
    numbers = _declared_numbers(name, constants or {}, parameters, bounds or {})
    _refuse_collisions(name, signals, numbers)
    the_states, the_inputs, the_outputs, the_ports = signals
    start = _initial(name, initial or {}, (*the_states, *the_inputs))
    all_numbers = ParameterSet((*numbers["constants"], *numbers["parameters"]))
    equations = UserEquations(
        name,
        *signals,
        all_numbers.names,
        rates,
        readings,
        flow,
        rate_ports=tuple(port.name for port in the_ports) if ports is None else (),
        rest_inputs=tuple(
            (each.name, start[each.name]) for each in the_inputs if each.name in start
        ),
        biased_outputs=_biased(name, biases, [signal.name for signal in the_outputs]),
    )
    return _model(equations, all_numbers, start, all_biases=biases is None)


_DeclaredSignals = tuple[
    tuple[Signal, ...], tuple[Signal, ...], tuple[Signal, ...], tuple[Signal, ...]
]


def _declared_signals(
    name: str, states: Units, inputs: Units, outputs: Units, ports: Units | None
) -> _DeclaredSignals:
    """Return the states, inputs, outputs and ports; without ``ports`` one port for each state."""
    moving = _signals(name, "states", states)
    return (
        moving,
        _signals(name, "inputs", inputs),
        _signals(name, "outputs", outputs),
        _rate_ports(moving) if ports is None else _signals(name, "ports", ports),
    )


def _declared_numbers(
    name: str, constants: Numbers, parameters: Numbers, bounds: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[Parameter, ...]]:
    """Return the constants and the free parameters of a declaration."""
    declared = {
        **_mapping(name, "parameters", parameters),
        **_mapping(name, "constants", constants),
    }
    limits = _bounds(name, bounds, declared)
    return {
        "constants": _numbers(name, "constants", constants, limits, free=False),
        "parameters": _numbers(name, "parameters", parameters, limits, free=True),
    }


def _model(
    equations: UserEquations, numbers: ParameterSet, start: Mapping[str, float], *, all_biases: bool
) -> Model:
    """Return the model of equations that were tried at their starts."""
    zero = {each.name: 0.0 for each in (*equations.states, *equations.inputs, *equations.ports)}
    starts = TrialPoint({TIME: 0.0, **zero, **start}, {item.name: item.value for item in numbers})
    with np.errstate(all="ignore"):  # away from the starts a root or a logarithm may have no value
        equations = replace(equations, flow_names=try_model(equations, starts))
        refuse_misnamed(equations, starts)
        multiplying_names = multiplying(equations, starts, numbers.free_names)
        equations = replace(
            equations,
            multiplying_parameters=tuple((name, numbers[name].unit) for name in multiplying_names),
            products=products(equations, starts, multiplying_names),
        )
        if all_biases:
            equations = replace(equations, biased_outputs=observable_biases(equations, starts))
    initial = [
        Parameter(
            s.name,
            start.get(s.name, 0.0),
            s.unit,
            source="declared" if s.name in start else "at rest",
        )
        for s in equations.states
    ]
    return Model(equations, numbers, ParameterSet(tuple(initial)))


def _rate_ports(states: Iterable[Signal]) -> tuple[Signal, ...]:
    return tuple(
        Signal(f"{state.name}_rate", rate_unit(state.unit), f"added to the rate of {state.name}")
        for state in states
    )


def rate_unit(unit: str) -> str:
    """Return the unit of a rate: ``rad/s`` of ``rad``, ``m/s2`` of ``m/s``."""
    match = re.fullmatch(r"(.+)/s(\d*)", unit)
    return f"{match[1]}/s{int(match[2] or 1) + 1}" if match else f"{unit}/s"


def _refuse_title(name: object) -> None:
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise ModelError(
            f"{name!r} is no name", where="own model", remedy='give name="..." on one line'
        )


def _mapping(model: str, what: str, some: object) -> Mapping[Any, Any]:
    if not isinstance(some, Mapping):
        entry = (
            '{"NAME": (START, "UNIT")}' if what in ("parameters", "constants") else '{"NAME": ...}'
        )
        raise ModelError(
            f"{what} is of type {type(some).__name__}",
            where=f"model {model}",
            remedy=f"give a mapping by name, {what}={entry}",
        )
    return some


def _refuse_uncallable(model: str, functions: Mapping[str, object]) -> None:
    for what, function in functions.items():
        if not callable(function):
            remedy = f"give a function of s and p, {what}=lambda s, p: {{...}}"
            raise ModelError(
                f"{what} is of type {type(function).__name__} and cannot be called",
                where=f"model {model}",
                remedy=remedy,
            )
        _refuse_other_arguments(model, what, function)


def _refuse_other_arguments(model: str, what: str, function: Callable[..., object]) -> None:
    """Raise ModelError if a function cannot be called with ``s`` and ``p``."""
    try:
        taken = signature(function)
    except (TypeError, ValueError):
        return
    try:
        taken.bind(None, None)
    except TypeError:
        where = written_in(model, what, function)
        remedy = f"give a function of s and p, {what}=lambda s, p: {{...}}"
        raise ModelError(f"it takes {taken}, not (s, p)", where=where, remedy=remedy) from None


def _signals(model: str, what: str, some: object) -> tuple[Signal, ...]:
    """Return the signals of a mapping name -> unit; there must be a state and an output."""
    result = _mapping(model, what, some)
    for name, unit in result.items():
        _refuse_name(model, what, name)
        _refuse_unit(f"model {model}, {what}, {name}", unit)
    if not result and what in ("states", "outputs"):
        raise ModelError(
            f"there is no {what[:-1]}",
            where=f"model {model}",
            remedy=f'give {what}={{"NAME": "UNIT"}}',
        )
    return tuple(Signal(name, unit) for name, unit in result.items())


def _refuse_name(model: str, what: str, name: object) -> None:
    where, remedy = f"model {model}, {what}", "use letters, digits and underscores, a letter first"
    if not isinstance(name, str) or not name.isidentifier() or name.startswith("_"):
        raise ModelError(f"{name!r} is no name", where=where, remedy=remedy)
    if keyword.iskeyword(name):
        raise ModelError(
            f"{name!r} is a word of Python itself", where=where, remedy="give it another name"
        )
    if what in ("parameters", "constants") and name.startswith(BIAS):
        raise ModelError(
            f"{name!r} would be taken for a sensor's bias",
            where=where,
            remedy=f"begin its name otherwise than with {BIAS}",
        )


def _refuse_unit(where: str, unit: object) -> None:
    if not isinstance(unit, str) or not unit.strip() or not unit.isprintable():
        what = (
            "the unit is empty"
            if isinstance(unit, str)
            else f"the unit is of type {type(unit).__name__}"
        )
        raise ModelError(
            what, where=where, remedy='give a text such as "rad/s", "1" for a pure number'
        )


def _numbers(
    model: str, what: str, some: object, limits: Mapping[str, tuple[float, float]], *, free: bool
) -> tuple[Parameter, ...]:
    out = []
    for name, entry in _mapping(model, what, some).items():
        _refuse_name(model, what, name)
        where = f"model {model}, {what}, {name}"
        if not isinstance(entry, tuple | list) or len(entry) != 2:
            raise ModelError(
                f"{entry!r} is no pair of a start and a unit",
                where=where,
                remedy=f'write "{name}": (START, "UNIT")',
            )
        _refuse_unit(where, entry[1])
        out.append(
            Parameter(
                name,
                _number(where, entry[0]),
                entry[1],
                bounds=limits.get(name, (-math.inf, math.inf)),
                free=free,
                source="declared",
            )
        )
    return tuple(out)


def _number(where: str, value: object, *, infinite: bool = False) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ModelError(
            f"{value!r} is no number",
            where=where,
            remedy="give a number in the unit that stands beside it",
        )
    number = float(value)
    if not math.isfinite(number) and not (infinite and math.isinf(number)):
        raise ModelError(
            f"{number} is no finite number", where=where, remedy="give a finite number"
        )
    return number


def _bounds(model: str, bounds: object, allowed: Collection[str]) -> dict[str, tuple[float, float]]:
    out = {}
    for name, pair in _mapping(model, "bounds", bounds).items():
        where = f"model {model}, bounds, {name}"
        if name not in allowed:
            raise ModelError(
                f"there is no parameter {name!r}",
                where=f"model {model}, bounds",
                remedy=f"use one of {', '.join(map(str, allowed))}",
            )
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise ModelError(
                f"{pair!r} is no pair of bounds",
                where=where,
                remedy=f'write "{name}": (LOWEST, HIGHEST)',
            )
        low, high = (_number(where, value, infinite=True) for value in pair)
        if not low < high:
            raise ModelError(
                f"{low:g} is not below {high:g}", where=where, remedy="give the lower bound first"
            )
        out[name] = (low, high)
    return out


def _initial(model: str, initial: object, signals: Iterable[Signal]) -> dict[str, float]:
    signal_names = [signal.name for signal in signals]
    initial_values = _mapping(model, "initial", initial)
    for name in initial_values:
        if name not in signal_names:
            raise ModelError(
                f"there is no state {name!r}",
                where=f"model {model}, initial",
                remedy=f"use one of {', '.join(signal_names)}",
            )
    return {
        name: _number(f"model {model}, initial, {name}", value)
        for name, value in initial_values.items()
    }


def _biased(model: str, biases: object, outputs: list[str]) -> tuple[str, ...]:
    if biases is None:
        return tuple(outputs)
    if isinstance(biases, str) or not isinstance(biases, Collection):
        raise ModelError(
            f"biases is of type {type(biases).__name__}",
            where=f"model {model}",
            remedy='give a list of outputs, biases=["NAME"]',
        )
    for name in biases:
        if name not in outputs:
            raise ModelError(
                f"there is no output {name!r}",
                where=f"model {model}, biases",
                remedy=f"use one of {', '.join(outputs)}",
            )
    return tuple(name for name in outputs if name in biases)


def _refuse_collisions(
    model: str, signals: _DeclaredSignals, numbers: Mapping[str, tuple[Parameter, ...]]
) -> None:
    """Raise ModelError for a name declared twice; only an output and a state may share one."""
    states, inputs, outputs, ports = signals
    declared: dict[str, Sequence[Signal | Parameter]] = {"states": states, "inputs": inputs}
    declared |= {"ports": ports, **numbers, "outputs": outputs}
    seen = {TIME: "time"}
    for what, items in declared.items():
        for item in items:
            there = seen.get(item.name)
            if there is not None and not (what == "outputs" and there == "states"):
                both = "the time" if there == "time" else f"among the {there}"
                raise ModelError(
                    f"{item.name!r} is {both} as well",
                    where=f"model {model}, {what}",
                    remedy="give each a name of its own",
                )
            seen[item.name] = what
