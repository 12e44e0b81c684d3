"""Parameters, and effects: physical phenomena with parameters of their own.

recorded input -> input path -> dynamics (with disturbances) -> sensor path -> recorded output

A parameter is a number with its unit, prior and bounds. An effect is a frozen object. It declares
its parameters, the values at which it vanishes exactly, and the functions (hooks) that its station
calls. Parameters have local names in the effect; their full names begin with the name of the
effect. Hooks are plain arithmetic that broadcasts over trailing batch axes and keeps the imaginary
part of a complex step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sim.errors import ModelError

# ---- Parameters of a model: a number with its unit, prior, bounds and origin; immutable

# Names that the constant of the declared airspeed has in equations.
AIRSPEEDS = ("airspeed", "reference_airspeed")
# Source of an initial value that a fit finds from the outputs at the first sample.
FROM_OUTPUTS = "from the outputs at the start"


@dataclass(frozen=True)
class Parameter:
    """One constant of a model.

    Attributes
    ----------
    name : name, unique within a model, e.g. ``"Cm_alpha"`` or ``"input-delay.delay"``.
    value : value in ``unit``.
    unit : unit in SI and radians; ``"1"`` for a pure number.
    prior_std : standard deviation of the prior about the value; ``inf`` without prior knowledge.
    bounds : physical limits, inclusive.
    free : whether the parameter is estimated; else it is held.
    source : origin of the value.
    """

    name: str
    value: float
    unit: str = "1"
    prior_std: float = math.inf
    bounds: tuple[float, float] = (-math.inf, math.inf)
    free: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not math.isfinite(self.value):
            raise ModelError(
                f"value {self.value} is not a finite number",
                where=f"parameter {self.name}",
                remedy="give a finite value",
            )
        if not low <= self.value <= high:
            raise ModelError(
                f"value {self.value:g} {self.unit} lies outside [{low:g}, {high:g}]",
                where=f"parameter {self.name}",
                remedy="give a value within the bounds",
            )
        if not self.prior_std > 0:
            raise ModelError(
                f"prior standard deviation {self.prior_std:g} is not positive",
                where=f"parameter {self.name}",
                remedy="give a positive one, or hold it",
            )


@dataclass(frozen=True)
class ParameterSet:
    """An ordered, immutable collection of parameters with unique names."""

    items: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        names = [item.name for item in self.items]
        for name in names:
            if names.count(name) > 1:
                raise ModelError(
                    "declared twice", where=f"parameter {name}", remedy="keep one of the two"
                )

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __getitem__(self, name: str) -> Parameter:
        return self.items[self.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items)

    @property
    def free_names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items if item.free)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {item.name: place for place, item in enumerate(self.items)}

    def index(self, name: str) -> int:
        """Return the position of a parameter; raise ModelError for an unknown name."""
        try:
            return self._places[name]
        except KeyError:
            raise ModelError(
                "there is no such parameter",
                where=name,
                remedy=f"use one of {', '.join(self.names)}",
            ) from None

    def values(self, names: Iterable[str] | None = None) -> np.ndarray:
        """Return the values in order, shape ``(n,)``; of all parameters or of those named."""
        chosen = self.items if names is None else [self[name] for name in names]
        return np.array([item.value for item in chosen], dtype=float)

    def with_values(self, values: Mapping[str, float]) -> ParameterSet:
        """Return a copy with some values replaced."""
        return self._changed({name: {"value": float(value)} for name, value in values.items()})

    def with_prior(self, prior_std: Mapping[str, float]) -> ParameterSet:
        """Return a copy with some prior standard deviations replaced."""
        return self._changed(
            {name: {"prior_std": float(value)} for name, value in prior_std.items()}
        )

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> ParameterSet:
        """Return a copy with some bounds replaced."""
        return self._changed(
            {name: {"bounds": (float(low), float(high))} for name, (low, high) in bounds.items()}
        )

    def hold(self, names: Iterable[str]) -> ParameterSet:
        """Return a copy with the named parameters fixed at their values."""
        return self._changed({name: {"free": False} for name in names})

    def release(self, names: Iterable[str]) -> ParameterSet:
        """Return a copy with the named parameters free (estimated)."""
        return self._changed({name: {"free": True} for name in names})

    def only_free(self, names: Iterable[str]) -> ParameterSet:
        """Return a copy with exactly the named parameters free (estimated)."""
        wanted = set(names)
        for name in wanted:
            self.index(name)
        return ParameterSet(tuple(replace(item, free=item.name in wanted) for item in self.items))

    def joined(self, other: Iterable[Parameter]) -> ParameterSet:
        """Return this set followed by further parameters."""
        return ParameterSet(self.items + tuple(other))

    def _changed(self, changes: Mapping[str, Mapping[str, Any]]) -> ParameterSet:
        for name in changes:
            self.index(name)
        return ParameterSet(
            tuple(replace(item, **changes.get(item.name, {})) for item in self.items)
        )


# ---- Effects: physical phenomena, each with a station on the signal chain


class Station(Enum):
    """Position of an effect in the signal chain, in the order of the data."""

    INPUT_PATH = "input path"
    DISTURBANCE = "disturbance"
    DYNAMICS = "dynamics"
    SENSOR_PATH = "sensor path"
    NOISE = "noise"


class Regularity(Enum):
    """Behaviour of the likelihood at the point where the effect is absent."""

    REGULAR = "regular: the score test holds"
    BOUNDARY = "on the boundary of the parameter space: one-sided test"
    INACTIVE = "without influence until it is large enough: score is zero at absence"
    UNIDENTIFIED_AT_ABSENCE = "a second parameter has no meaning at absence: search over it"
    CHANGE_POINT = "acts from an unknown time: search over it"
    OUTLIER = "isolated samples"
    PROCESS_NOISE = "random forcing: judged by innovations, not by simulation"


@dataclass(frozen=True)
class Signal:
    """A named quantity on the model's bus, with unit and meaning."""

    name: str
    unit: str
    meaning: str = ""


@runtime_checkable
class Effect(Protocol):
    """Declaration common to all effects.

    Attributes
    ----------
    name : name of the instance, ``"input-delay"`` or, with a channel, ``"sensor-lag:q"``.
    station : place in the signal chain.
    parameters : parameters with local names; values are starts of a fit, bounds are physical
        limits.
    absent : local name -> value at which the effect vanishes bit for bit; parameters that are not
        named may then have any value.
    regularity : behaviour of the likelihood at absence, which decides the kind of test.
    aliases : names of effects that usual records do not distinguish from this one.
    explanation : a paragraph that a student understands.
    """

    @property
    def name(self) -> str: ...
    @property
    def station(self) -> Station: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def absent(self) -> Mapping[str, float]: ...
    @property
    def regularity(self) -> Regularity: ...
    @property
    def aliases(self) -> tuple[str, ...]: ...
    @property
    def explanation(self) -> str: ...


@runtime_checkable
class InputEffect(Effect, Protocol):
    """Acts on one input between the record and the vehicle.

    ``act(edges, u, p)`` takes the means ``u (n_cells, ...)`` of the input over cells with the
    boundaries ``edges (n_cells + 1,)``, s, and returns the means behind the effect.

    The attribute ``path_order`` determines its place on the path (see ``in_order``). An effect with
    ``commutes = True`` only shifts the input in time. With fixed parameters it may therefore act on
    the recorded input, ahead of effects that are states of a filter.
    """

    @property
    def signal(self) -> str: ...
    def act(self, edges: Any, u: Any, p: Any) -> Any: ...


@runtime_checkable
class DynamicsEffect(Effect, Protocol):
    """Adds to the ports of the equations of motion, with or without states of its own.

    ``increments(s, vehicle, p)`` returns ``{port: value}``, and ``derivatives(s, vehicle, p)`` one
    rate for each of ``states``. Effects of the station ``DISTURBANCE`` act before the flow
    quantities are computed, those of ``DYNAMICS`` after.
    """

    @property
    def states(self) -> tuple[Signal, ...]: ...
    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]: ...
    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]: ...


@runtime_checkable
class ParameterEffect(Effect, Protocol):
    """Makes a parameter of the equations vary: ``change(s, p)`` is added to ``parameter``.

    The change is added after the disturbances and before the parameter is used. It is linear in the
    effect's own parameters, which are all zero at absence.
    """

    @property
    def parameter(self) -> str: ...
    def change(self, s: Any, p: Any) -> Any: ...


@runtime_checkable
class GroupEffect(Effect, Protocol):
    """Makes several parameters of the equations vary at once.

    ``changes(s, p)`` returns the change of each parameter of ``group`` by name; see
    `ParameterEffect`.
    """

    @property
    def group(self) -> tuple[str, ...]: ...
    def changes(self, s: Any, p: Any) -> Mapping[str, Any]: ...


@runtime_checkable
class SensorEffect(Effect, Protocol):
    """Acts on one output channel with memory, on the grid of sub-steps.

    ``act(steps, begin, end, p)`` takes sub-step sizes ``steps (M,)``, s, values at the begin of
    each sub-step and at the final sample, ``begin (M + 1, ...)``, and values at the end of each
    sub-step, ``end (M, ...)``. It returns ``(begin, end)`` behind the sensor. The value at the end
    of a sub-step differs from that at the begin of the next one if the input jumps there.
    """

    @property
    def channel(self) -> str: ...
    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]: ...


@dataclass(frozen=True)
class SensorMemory:
    """A sensor with memory as a first-order system.

    It reads ``direct`` y + (1 - ``direct``) x, where x follows y with a first-order lag. For a lag
    ``direct`` is 0. For a delay it is -1 with half the delay as time constant: Pade's approximation
    of first order.

    Attributes
    ----------
    row : index of the output in its System.
    time_constant : time constant of x, s.
    direct : share of y itself in the reading.
    """

    row: int
    time_constant: Any
    direct: float


@runtime_checkable
class RememberingEffect(SensorEffect, Protocol):
    """A sensor whose memory can be written as a state.

    ``memory(p)`` returns its time constant, s, and its ``direct`` share (see `SensorMemory`).
    """

    def memory(self, p: Any) -> tuple[Any, float]: ...


@runtime_checkable
class ReadingEffect(Effect, Protocol):
    """Acts on output channels without memory.

    ``read(s, y, vehicle, p)`` returns ``{channel: new value}``.
    """

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]: ...


@runtime_checkable
class ClockEffect(Effect, Protocol):
    """The clock of the record is wrong: ``pace(p)`` is the time that it counts in one true second.

    The rates of all states of the dynamics, and the density of random forcing, are divided by it.
    Readings are those of the true motion. Times of events and of effects on the input and sensor
    path are in the record's time.
    """

    def pace(self, p: Any) -> Any: ...


@runtime_checkable
class StateJumpEffect(Effect, Protocol):
    """Makes states of the vehicle jump, without a force and without a change of readings.

    ``added_rates(s, rates, p)`` returns the rate to add, by state, to the ``rates`` of the
    equations. ``states_read`` are all states, in order, of the equations for which the effect is
    made.
    """

    @property
    def states_read(self) -> Sequence[str]: ...
    def added_rates(self, s: Any, rates: Sequence[Any], p: Any) -> Mapping[str, Any]: ...


@runtime_checkable
class OnlineForm(Protocol):
    """State form of an input or sensor effect, for filters that see one sample at a time.

    ``online_states`` are the states. For an incoming signal ``v``, ``rates(v, x, p)`` returns the
    derivatives of the states ``x``, and ``pass_on(v, x, p)`` the outgoing signal.
    """

    @property
    def online_states(self) -> tuple[Signal, ...]: ...
    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]: ...
    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any: ...


@runtime_checkable
class NoiseEffect(Effect, Protocol):
    """Drives its own states by white noise.

    ``density(vehicle, p)`` returns the spectral density of the noise on each state's rate.
    """

    def density(self, vehicle: Any, p: Any) -> Sequence[Any]: ...


@runtime_checkable
class OnSignal(Protocol):
    """Acts on the input ``signal``: on a vehicle without it the effect is not offered."""

    @property
    def signal(self) -> str: ...


@runtime_checkable
class OnChannel(Protocol):
    """Acts on the output ``channel``: on a vehicle without it the effect is not offered."""

    @property
    def channel(self) -> str: ...


@runtime_checkable
class NeedsPorts(Protocol):
    """Adds to ports of the equations, which a vehicle must have."""

    @property
    def needs(self) -> Sequence[str]: ...


@runtime_checkable
class NeedsConstants(Protocol):
    """Needs constants of the equations, named in ``needs_constants``."""

    @property
    def needs_constants(self) -> Sequence[str]: ...


@runtime_checkable
class ReadsRates(Protocol):
    """Reads the rates of the states in ``rates_read``, from the bus as ``STATE_dot``.

    The rates include all other effects.
    """

    @property
    def rates_read(self) -> Sequence[str]: ...


@runtime_checkable
class ReadsOutputs(Protocol):
    """An effect on one sensor that reads other outputs, named in ``outputs_read``."""

    @property
    def outputs_read(self) -> Sequence[str]: ...


@runtime_checkable
class ReadsStates(Protocol):
    """An effect that reads states of the equations, named in ``states_read``.

    It is not offered for a vehicle without them.
    """

    @property
    def states_read(self) -> Sequence[str]: ...


@runtime_checkable
class Ranked(Protocol):
    """Has a place among the effects of its station, see ``in_order``."""

    @property
    def path_order(self) -> int: ...


@runtime_checkable
class Commuting(Protocol):
    """An input effect that, if ``commutes``, only shifts the input in time."""

    @property
    def commutes(self) -> bool: ...


@runtime_checkable
class Anticipating(Protocol):
    """An input effect that, if ``anticipates``, needs future inputs.

    No filter can use it, not even with fixed parameters.
    """

    @property
    def anticipates(self) -> bool: ...


def ports_needed(effect: object) -> Sequence[str]:
    """Return the names of the ports that an effect adds to; empty if it declares none."""
    return effect.needs if isinstance(effect, NeedsPorts) else ()


def constants_needed(effect: object) -> Sequence[str]:
    """Return the names of the constants that an effect needs; empty if it declares none."""
    return effect.needs_constants if isinstance(effect, NeedsConstants) else ()


def rates_read_by(effect: object) -> Sequence[str]:
    """Return the names of the states whose rates an effect reads; empty if it declares none."""
    return effect.rates_read if isinstance(effect, ReadsRates) else ()


def outputs_read_by(effect: object) -> Sequence[str]:
    """Return the names of other outputs that a sensor effect reads; empty if it declares none."""
    return effect.outputs_read if isinstance(effect, ReadsOutputs) else ()


def states_read_by(effect: object) -> Sequence[str]:
    """Return the names of the states that an effect reads; empty if it declares none."""
    return effect.states_read if isinstance(effect, ReadsStates) else ()


def in_order(effects: Sequence[Any]) -> list[Any]:
    """Return the effects of one station in the order in which a signal passes them.

    The order is that of ``path_order``, which is 0 for an effect without one. Effects of equal
    ``path_order`` keep the order in which they were added.
    """
    return sorted(
        effects, key=lambda effect: effect.path_order if isinstance(effect, Ranked) else 0
    )


def full_name(effect: Effect, local: str) -> str:
    """Return the name of an effect's parameter in the model, such as ``"input-delay.delay"``.

    An effect with a method ``rename`` decides the name: ``CL_eta`` of mode 2 is ``CL_eta2``.
    """
    # A search calls this ten thousand times; a test against a protocol would take ten times longer.
    rename: Callable[[str], str] | None = getattr(effect, "rename", None)
    return rename(local) if rename is not None else f"{effect.name}.{local}"
