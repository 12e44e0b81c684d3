"""Common parts of effects: instances for the inputs and outputs of given equations, their names and
sizes; advice that separates effects; coefficients of controls; base classes; play.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from sim.declaration.effect import (
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
from sim.declaration.proposal import Probe, SearchContext, Traceable, shares_of_peak
from sim.declaration.user_equations import OwnEquations
from sim.maths import maximum, minimum

# ---- Instances of an effect on the inputs and outputs of any equations

# Inputs and outputs (name, unit) whose instances are in ``VARIANTS`` of the effects' files.
KNOWN_INPUTS = {("elevator", "rad"), ("stick", "1")}
KNOWN_OUTPUTS = {("alpha", "rad"), ("q", "rad/s"), ("nz", "g"), ("altitude", "m")}
# Port -> unit that effects use for it.
PORT_UNITS = {"gust": "rad", "headwind": "m/s", "airspeed_change": "m/s", "density_change": "kg/m3"}
ATTITUDE = "theta"  # as an input it is a measured attitude and no control
# Ports of air motion; the other ports take loads.
AIR = ("gust", "headwind", "airspeed_change", "density_change", "log_density", "log_drag")
# Unit -> typical large deflection; unit -> typical large reading.
_LARGE_INPUT = {"rad": 0.1, "1": 1.0}
_LARGE_OUTPUT = {"rad": 0.2, "rad/s": 0.2, "g": 2.0, "m/s": 20.0, "m": 1000.0, "m/s2": 20.0}


def labelled(name: str, label: str) -> str:
    """Return a name with a label, ``input-delay:rudder``; the plain name if the label is empty."""
    return f"{name}:{label}" if label else name


def all_labelled(names: Iterable[str], label: str) -> tuple[str, ...]:
    """Return several names with the same label, as ``labelled``."""
    return tuple(labelled(name, label) for name in names)


def controls(equations: Equations) -> tuple[Signal, ...]:
    """Return the inputs that a pilot or controller moves: no measured motion or air data."""
    attitude = () if isinstance(equations, OwnEquations) else (ATTITUDE,)
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
        # These equations include the input path.
        return ()
    moved = controls(equations)
    several = len(moved) > 1
    return tuple(
        (signal, signal.name if several else "")
        for signal in moved
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
    """Return a maker of effects whose size is a share of a large deflection in the input's unit."""
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
    """Return whether input, output and ports of an effect have the units that it is written for."""
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
    """Return the ports that take loads."""
    return tuple(port for port in equations.ports if port.name not in AIR)


def ports_without(variants: Iterable[Traceable], equations: OwnEquations) -> tuple[Signal, ...]:
    """Return the load ports of a user model on which none of the effects ``variants`` acts."""
    parameter_names, ports = {*equations.parameter_names}, {port.name for port in equations.ports}
    acting = (
        effect
        for effect in variants
        if parameter_names.issuperset(constants_needed(effect))
        and ports.issuperset(ports_needed(effect))
    )
    covered = {port for effect in acting for port in ports_needed(effect)}
    return tuple(port for port in load_ports(equations) if port.name not in covered)


def per_unit(port: str, *signals: str) -> str:
    """Return the unit of the derivative of a port by a product of signals, as ``m/s2/(m/s)/N``."""
    below = (f"({unit})" if "/" in unit or " " in unit else unit for unit in signals if unit != "1")
    return "/".join((port, *below))


# ---- Maneuvers that separate effects, where several effects share the advice

MANY_SIZES = (
    "inputs of many sizes (a multisine, or steps of five sizes): on three levels these are one and "
    "the same function"
)
FASTER_MOTION = (
    "faster motion (short doublets, or a sweep up to the inverse of the lag): a lag loses "
    "amplitude there, a delay does not"
)
STEADY_FLIGHT = "steady flight before and after the maneuver, and the airspeed recorded"
ANOTHER_FALL = (
    "a fall that begins higher or faster: it meets the same density at another Mach number"
)
BEYOND_PRODUCTS = (
    "both signals moved far, together and one after the other: as long as a derivative grows "
    "evenly with a signal, a record shows only the product of two signals, whichever of the two "
    "derivatives it is"
)


# ---- Coefficients of each lateral control, main one first


@dataclass(frozen=True)
class LateralControl:
    """A lateral control surface.

    Attributes
    ----------
    control : signal of the control.
    moment_by, lift_by : its main moment derivative, and that of the side force.
    ports : ports of this moment and of the side force.
    further : port and derivative of its other moment.
    """

    control: str
    moment_by: str
    lift_by: str
    ports: tuple[str, str]
    further: tuple[tuple[str, str], ...]


LATERAL_CONTROLS = (
    LateralControl("aileron", "Cl_da", "CY_da", ("roll", "side_force"), (("yaw", "Cn_da"),)),
    LateralControl("rudder", "Cn_dr", "CY_dr", ("yaw", "side_force"), (("roll", "Cl_dr"),)),
)


# ---- Nonlinear control effectiveness

SHARES: Mapping[str, tuple[float, float]] = {"lift_share": (-3.0, 5.0)}


@dataclass(frozen=True)
class NonlinearControl:
    """moment += moment_by f(d), lift += ``lift_share`` lift_by f(d) for a deflection d, with the
    vehicle's derivatives by the control.

    ``lift_share`` is one if lift and moment come from one force on the surface, and zero if only
    the moment is nonlinear. f has one further parameter, ``bend``; a subclass defines its
    ``curve``.

    Attributes
    ----------
    control : signal of the control.
    moment_by, lift_by : names of its derivatives.
    share_free : whether ``lift_share`` is estimated; it is not for a control with hardly any lift.
    ports : ports of the moment and of the lift.
    further : further ports, each with its derivative by the control.
    label : suffix of the effect's name, where the vehicle has several controls.
    speed : name of the constant that is the declared airspeed. With a ``reference_airspeed``
        deflections are totals, and d counts from ``middle``, the middle of the range.
    """

    control: str = "elevator"
    moment_by: str = "Cm_de"
    lift_by: str = "CL_de"
    share_free: bool = True
    ports: tuple[str, str] = ("moment", "lift")
    further: tuple[tuple[str, str], ...] = ()
    label: str = ""
    speed: str = "airspeed"
    middle: float = 0.0

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    states: ClassVar[tuple[Signal, ...]] = ()
    bend: ClassVar[Parameter]

    @property
    def name(self) -> str:
        return labelled("control-nonlinearity", self.label)

    @property
    def absent(self) -> Mapping[str, float]:
        return {self.bend.name: 0.0}

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.ports, *(port for port, _ in self.further))

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (
            self.moment_by,
            self.lift_by,
            *(derivative for _, derivative in self.further),
            self.speed,
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            self.bend,
            Parameter(
                "lift_share", 1.0, "1", prior_std=1.0, bounds=(-10.0, 10.0), free=self.share_free
            ),
        )

    def curve(self, d: Any, p: Any) -> Any:
        """Return f(d)."""
        raise NotImplementedError

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        d = getattr(s, self.control)
        more = self.curve(d - self.middle if self.middle else d, p)
        moment = getattr(vehicle, self.moment_by) * more
        lift = p.lift_share * getattr(vehicle, self.lift_by) * more
        others = {port: getattr(vehicle, derivative) * more for port, derivative in self.further}
        return {self.ports[0]: moment, self.ports[1]: lift, **others}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def used(self, context: SearchContext) -> tuple[float, float]:
        """Return the largest deflection from the middle in a record, and the middle, in the
        control's unit.
        """
        low, high = context.flown_range(self.control) or context.flown_range("stick") or (0.0, 0.0)
        middle = 0.0 if self.speed == "airspeed" else 0.5 * (low + high)
        return max(abs(low - middle), abs(high - middle)), middle

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the slope at absence, with lift and moment from one force."""
        return (Probe({**self.absent, "lift_share": 1.0}, (self.bend.name,)),)


Form = TypeVar("Form", bound=NonlinearControl)


def of_all_controls(form: type[Form], **pseudo_control: float) -> tuple[Form, ...]:
    """Return a form for the controls of all built-in equations.

    ``pseudo_control`` has the attributes of the form on the pseudo-control of the low-order
    equivalent system.
    """
    lateral = (
        form(
            control=c.control,
            moment_by=c.moment_by,
            lift_by=c.lift_by,
            share_free=False,
            ports=c.ports,
            further=c.further,
            label=c.control,
        )
        for c in LATERAL_CONTROLS
    )
    stick = form(
        control="delta",
        moment_by="M_delta",
        lift_by="L_delta",
        share_free=False,
        **pseudo_control,  # type: ignore[arg-type]
    )
    return (form(), stick, *lateral, form(label="elevator", speed="reference_airspeed"))


# ---- Base classes of effects on one input or one channel


class OfInput:
    """An effect on one recorded input, named after its ``family`` and the label of the input."""

    signal: str
    label: str
    family: ClassVar[str]
    station: ClassVar[Station] = Station.INPUT_PATH

    @property
    def name(self) -> str:
        return labelled(self.family, self.label)


class OfChannel:
    """An effect on one output channel, named after its ``family`` and the channel."""

    channel: str
    family: ClassVar[str]
    station: ClassVar[Station] = Station.SENSOR_PATH

    @property
    def name(self) -> str:
        return f"{self.family}:{self.channel}"


@dataclass(frozen=True)
class SizedOnInput(OfInput):
    """An effect on an input with one parameter, in the unit of that input.

    A subclass has ``typical_share_of_peak``, the typical value as a share of the input's peak.

    Attributes
    ----------
    signal, unit : name and unit of the input.
    typical : starting value of the parameter; if not ``sized``, it follows from the record.
    label : suffix of the effect's name, where the vehicle has several inputs.
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


# ---- Shared parts of dead band and backlash

ABSENT: Mapping[str, float] = MappingProxyType({"half_width": 0.0})


def half_width(typical: float, unit: str) -> tuple[Parameter, ...]:
    """Return the parameter ``half_width``, which is not negative, as a tuple of one."""
    return (Parameter("half_width", typical, unit, bounds=(0.0, 1e9)),)


def plausible_half_width(typical: float) -> Mapping[str, tuple[float, float]]:
    """Return the plausible range: up to ten times the typical value."""
    return {"half_width": (0.0, 10.0 * typical)}


def tried(context: SearchContext, signal: str) -> Sequence[Probe]:
    """Return values to probe, from a small share of the input's peak to more than half of it."""
    return [
        Probe({"half_width": size})
        for size in shares_of_peak(context, signal, (0.04, 0.12, 0.3, 0.6))
    ]


# ---- Play


def played(u: np.ndarray, half_width: Any) -> np.ndarray:
    """Return the output ``(n,)`` of backlash for one input ``u (n,)``.

    While the input rises y = max(y0, u - half_width), and while it falls y = min(y0, u +
    half_width), where y0 is the output at the last turn of the input.
    """
    change = np.sign(np.diff(u.real))
    moves = np.flatnonzero(change)
    # Index of the last cell before the first move of each turn.
    turns = moves[1:][change[moves[1:]] != change[moves[:-1]]]
    last = np.append(turns, len(u) - 1)
    rising = bool(len(moves) == 0 or change[moves[0]] > 0)
    y, positions = u[0].item(), []
    for k, value in enumerate(u[last].tolist()):
        positions.append(y)
        up = rising == (k % 2 == 0)
        pushed = value - half_width if up else value + half_width
        if pushed.real > y.real if up else pushed.real < y.real:
            y = pushed
    count = np.diff(last, prepend=-1)
    from_last = np.repeat(np.array(positions), count)
    upward = np.repeat((np.arange(len(last)) % 2 == 0) == rising, count)
    return np.where(upward, maximum(from_last, u - half_width), minimum(from_last, u + half_width))
