"""Parts that several effects have in common.

They are: instances of an effect for the inputs, outputs and ports of given equations, with names
and typical sizes; advice on maneuvers that distinguish effects; base classes; dead band and
backlash.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from sim.declaration.effect import (
    Effect,
    OnChannel,
    OnSignal,
    Parameter,
    Regularity,
    Signal,
    Station,
    constants_needed,
    ports_needed,
)
from sim.declaration.model import Containing, DrivenByOthers, Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.user_equations import UserEquations
from sim.maths import maximum, minimum

# ---- Instances of an effect on the inputs and outputs of any equations

# Inputs and outputs, as (name, unit), of the instances in ``VARIANTS`` of the effects' files.
KNOWN_INPUTS = {("elevator", "rad"), ("stick", "1")}
KNOWN_OUTPUTS = {("alpha", "rad"), ("q", "rad/s"), ("nz", "g"), ("altitude", "m")}
# Unit of ports of air motion for which effects are written.
PORT_UNITS = {"gust": "rad", "headwind": "m/s", "airspeed_change": "m/s", "density_change": "kg/m3"}
ATTITUDE = "theta"  # as an input it is a measured attitude, not a control
# Ports of air motion and of the drag of a falling body; the other ports take loads.
AIR = ("gust", "headwind", "airspeed_change", "density_change", "log_density", "log_drag")
# Typical large deflection and typical large reading, by unit.
_LARGE_INPUT = {"rad": 0.1, "1": 1.0}
_LARGE_OUTPUT = {"rad": 0.2, "rad/s": 0.2, "g": 2.0, "m/s": 20.0, "m": 1000.0, "m/s2": 20.0}


def labelled(name: str, label: str) -> str:
    """Return a name with a label, ``input-delay:rudder``; the plain name if the label is empty."""
    return f"{name}:{label}" if label else name


def all_labelled(names: Iterable[str], label: str) -> tuple[str, ...]:
    """Return several names with the same label, as ``labelled``."""
    return tuple(labelled(name, label) for name in names)


def controls(equations: Equations) -> tuple[Signal, ...]:
    """Return the inputs that a pilot or controller moves, without measured motion and air data."""
    attitude = () if isinstance(equations, UserEquations) else (ATTITUDE,)
    others = {
        *attitude,
        *(port.name for port in equations.ports),
        *(equations.no_controls if isinstance(equations, DrivenByOthers) else ()),
    }
    return tuple(signal for signal in equations.inputs if signal.name not in others)


def further_inputs(equations: Equations) -> tuple[tuple[Signal, str], ...]:
    """Return the inputs that no ``VARIANTS`` cover, each with the label of its instances.

    The label is the name of the input if there are several inputs, else it is empty.
    """
    if isinstance(equations, Containing):
        return ()  # these equations include the input path
    inputs = controls(equations)
    several = len(inputs) > 1
    return tuple(
        (signal, signal.name if several else "")
        for signal in inputs
        if several or (signal.name, signal.unit) not in KNOWN_INPUTS
    )


def further_outputs(equations: Equations) -> tuple[Signal, ...]:
    """Return the outputs that no ``VARIANTS`` cover."""
    return tuple(
        signal for signal in equations.outputs if (signal.name, signal.unit) not in KNOWN_OUTPUTS
    )


def for_inputs(
    equations: Equations, *makers: Callable[[Signal, str], Traceable]
) -> tuple[Traceable, ...]:
    """Return the effects that each maker makes, from a signal and a label, for each of the
    ``further_inputs``.
    """
    inputs = further_inputs(equations)
    return tuple(make(signal, label) for make in makers for signal, label in inputs)


def sized(
    kind: Callable[[str, str, float, str, bool], Traceable], share: float
) -> Callable[[Signal, str], Traceable]:
    """Return a maker of effects whose size is a share of a typical large deflection."""
    return lambda signal, label: kind(
        signal.name,
        signal.unit,
        share * large_input(signal.unit),
        label,
        has_typical_size(signal.unit),
    )


def for_outputs(
    equations: Equations, *makers: Callable[[Signal], Traceable]
) -> tuple[Traceable, ...]:
    """Return the effects that each maker makes for each of the ``further_outputs``."""
    outputs = further_outputs(equations)
    return tuple(make(signal) for make in makers for signal in outputs)


def large_input(unit: str) -> float:
    """Return a typical large deflection in a unit; 1 for an unknown unit.

    In an unknown unit the size follows from the peak of the recorded input.
    """
    return _LARGE_INPUT.get(unit, 1.0)


def has_typical_size(unit: str) -> bool:
    """Return whether ``large_input`` knows the unit."""
    return unit in _LARGE_INPUT


def has_typical_output_size(unit: str) -> bool:
    """Return whether ``large_output`` knows the unit."""
    return unit in _LARGE_OUTPUT


def in_its_unit(effect: object, equations: Equations) -> bool:
    """Return whether the input, output and ports of an effect have the units for which it is
    written.
    """
    units = {signal.name: signal.unit for signal in (*equations.inputs, *equations.outputs)}
    name = (
        effect.signal
        if isinstance(effect, OnSignal)
        else effect.channel
        if isinstance(effect, OnChannel)
        else ""
    )
    wanted = getattr(effect, "unit", units.get(name, ""))
    ports = {port.name: port.unit for port in equations.ports}
    ports_agree = all(
        ports.get(port) == PORT_UNITS[port] for port in ports_needed(effect) if port in PORT_UNITS
    )
    return ports_agree and (name not in units or wanted == units[name])


def large_output(unit: str) -> float:
    """Return a typical large reading in a unit; 1 for an unknown unit."""
    return _LARGE_OUTPUT.get(unit, 1.0)


def per(unit: str) -> str:
    """Return the unit 1/unit."""
    return f"1/({unit})" if "/" in unit or " " in unit else f"1/{unit}"


def per_square(unit: str) -> str:
    """Return the unit 1/unit^2."""
    return f"1/({unit})/({unit})" if "/" in unit or " " in unit else f"1/{unit}2"


def load_ports(equations: Equations) -> tuple[Signal, ...]:
    """Return the ports to which forces and moments can be added."""
    return tuple(port for port in equations.ports if port.name not in AIR)


def has_its_constants_and_ports(effect: object, equations: Equations) -> bool:
    """Return whether equations have the constants and the ports that an effect needs."""
    ports = {port.name for port in equations.ports}
    return {*equations.parameter_names}.issuperset(constants_needed(effect)) and ports.issuperset(
        ports_needed(effect)
    )


def ports_without(variants: Iterable[Traceable], equations: UserEquations) -> tuple[Signal, ...]:
    """Return the load ports of a user model to which none of the effects ``variants`` adds."""
    covered = {
        port
        for effect in variants
        if has_its_constants_and_ports(effect, equations)
        for port in ports_needed(effect)
    }
    return tuple(port for port in load_ports(equations) if port.name not in covered)


def per_unit(port: str, *signals: str) -> str:
    """Return the unit of the derivative of a port by a product of signals, such as
    ``m/s2/(m/s)/N``.
    """
    below = (f"({unit})" if "/" in unit or " " in unit else unit for unit in signals if unit != "1")
    return "/".join((port, *below))


# ---- Advice on maneuvers that distinguish effects, where several effects share it

MANY_SIZES = (
    "inputs of many sizes (a multisine, or steps of five sizes): on three levels these are one and "
    "the same function"
)
STEADY_FLIGHT = "steady flight before and after the maneuver, and the airspeed recorded"
ANOTHER_FALL = (
    "a fall that begins higher or faster: it meets the same density at another Mach number"
)


# ---- Base classes: parts of the declaration that many effects have alike


class WithoutStates:
    """Base of effects in the equations of motion that have no states."""

    states: ClassVar[tuple[Signal, ...]] = ()

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


class ProbedAtAbsence:
    """Base of effects with one probe: the slopes at absence by all parameters of ``absent``."""

    def probes(self: Effect, context: SearchContext) -> Sequence[Probe]:
        return (Probe(self.absent, tuple(self.absent)),)


class OfInput:
    """Base of effects on one recorded input, named by ``family`` and the label of the input."""

    signal: str
    label: str
    family: ClassVar[str]
    station: ClassVar[Station] = Station.INPUT_PATH

    @property
    def name(self) -> str:
        return labelled(self.family, self.label)


class OfChannel:
    """Base of effects on one output channel, named after its ``family`` and the channel."""

    channel: str
    family: ClassVar[str]
    station: ClassVar[Station] = Station.SENSOR_PATH

    @property
    def name(self) -> str:
        return f"{self.family}:{self.channel}"


@dataclass(frozen=True)
class SizedOnInput(OfInput):
    """Base of effects on an input with one parameter, in the unit of that input.

    A subclass has ``typical_share_of_peak``, the typical value as a share of the input's peak.

    Attributes
    ----------
    signal, unit : name and unit of the input.
    typical : starting value of the parameter.
    label : suffix of the effect's name, where the vehicle has several inputs.
    sized : whether a typical size is known for the unit. Otherwise the starting value follows from
        the peak of the recorded input.
    """

    signal: str = "elevator"
    unit: str = "rad"
    typical: float = 0.01
    label: str = ""
    sized: bool = True

    typical_share_of_peak: ClassVar[float]

    def fitted_to(self, context: SearchContext) -> Self:
        """Return the effect; if it is not ``sized``, with a size from the peak of the record."""
        peak = context.input_peak.get(self.signal, 0.0)
        return (
            self
            if self.sized or not peak > 0.0
            else replace(self, typical=self.typical_share_of_peak * peak)
        )


# ---- Dead band and backlash


class HalfWidth:
    """Base of dead bands and backlash: one parameter ``half_width``, which is not negative.

    Up to ten times the ``typical`` half width is plausible.
    """

    unit: str
    typical: float

    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"half_width": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("half_width", self.typical, self.unit, bounds=(0.0, 1e9)),)

    @property
    def plausible(self) -> Mapping[str, tuple[float, float]]:
        return {"half_width": (0.0, 10.0 * self.typical)}


def backlash(u: np.ndarray, half_width: Any) -> np.ndarray:
    """Return the output ``(n,)`` of backlash for one input ``u (n,)``.

    While the input rises y = max(y0, u - half_width), and while it falls y = min(y0, u +
    half_width), where y0 is the output at the last reversal of the input.
    """
    change = np.sign(np.diff(u.real))
    moves = np.flatnonzero(change)
    # Index of the last cell before each reversal.
    reversals = moves[1:][change[moves[1:]] != change[moves[:-1]]]
    last = np.append(reversals, len(u) - 1)
    rising = bool(len(moves) == 0 or change[moves[0]] > 0)
    y, at_reversals = u[0].item(), []
    for k, value in enumerate(u[last].tolist()):
        at_reversals.append(y)
        up = rising == (k % 2 == 0)
        pushed = value - half_width if up else value + half_width
        if pushed.real > y.real if up else pushed.real < y.real:
            y = pushed
    count = np.diff(last, prepend=-1)
    y0 = np.repeat(np.array(at_reversals), count)
    upward = np.repeat((np.arange(len(last)) % 2 == 0) == rising, count)
    return np.where(upward, maximum(y0, u - half_width), minimum(y0, u + half_width))
