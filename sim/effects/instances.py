"""Instances of an effect on the inputs and outputs of given equations: names, sizes, advice to
separate them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from sim.declaration.effect import OnChannel, OnSignal, Signal, constants_needed, ports_needed
from sim.declaration.model import Containing, DrivenByOthers, Equations
from sim.declaration.proposal import Traceable
from sim.declaration.user_equations import OwnEquations

# ---- Instances of an effect on the inputs and outputs of any equations

# Name and unit of those whose instances stand in the effects' own files.
KNOWN_INPUTS = {("elevator", "rad"), ("stick", "1")}
KNOWN_OUTPUTS = {("alpha", "rad"), ("q", "rad/s"), ("nz", "g"), ("altitude", "m")}
# as the effects count what comes in there
PORT_UNITS = {"gust": "rad", "headwind": "m/s", "airspeed_change": "m/s", "density_change": "kg/m3"}
ATTITUDE = "theta"  # where it is an input it was measured, as an airspeed that is a port
# Ports through which the air comes in; the others take loads.
AIR = ("gust", "headwind", "airspeed_change", "density_change", "log_density", "log_drag")
_LARGE_INPUT = {"rad": 0.1, "1": 1.0}
_LARGE_OUTPUT = {"rad": 0.2, "rad/s": 0.2, "g": 2.0, "m/s": 20.0, "m": 1000.0, "m/s2": 20.0}


def labelled(name: str, label: str) -> str:
    """``input-delay:rudder``; the plain name where the label is empty."""
    return f"{name}:{label}" if label else name


def all_labelled(names: Iterable[str], label: str) -> tuple[str, ...]:
    """Several names with the same label."""
    return tuple(labelled(name, label) for name in names)


def controls(equations: Equations) -> tuple[Signal, ...]:
    """Inputs that somebody moves: not those that are measured motion or air, which take the place
    of a port or of the attitude.
    """
    attitude = () if isinstance(equations, OwnEquations) else (ATTITUDE,)
    others = {
        *attitude,
        *(port.name for port in equations.ports),
        *(equations.no_controls if isinstance(equations, DrivenByOthers) else ()),
    }
    return tuple(signal for signal in equations.inputs if signal.name not in others)


def further_inputs(equations: Equations) -> tuple[tuple[Signal, str], ...]:
    """Inputs that need instances of their own, with the label of each: its name where there are
    several inputs.
    """
    if isinstance(equations, Containing):
        # What lies between input and vehicle is part of these equations.
        return ()
    moved = controls(equations)
    several = len(moved) > 1
    return tuple(
        (signal, signal.name if several else "")
        for signal in moved
        if several or (signal.name, signal.unit) not in KNOWN_INPUTS
    )


def further_outputs(equations: Equations) -> tuple[Signal, ...]:
    """Outputs that need instances of their own."""
    return tuple(
        signal for signal in equations.outputs if (signal.name, signal.unit) not in KNOWN_OUTPUTS
    )


def for_inputs(
    equations: Equations, *makers: Callable[[Signal, str], Traceable]
) -> tuple[Traceable, ...]:
    """What each maker gives for each input that has no instance yet: of a signal and a label."""
    inputs = further_inputs(equations)
    return tuple(make(signal, label) for make in makers for signal, label in inputs)


def sized(
    kind: Callable[[str, str, float, str, bool], Traceable], share: float
) -> Callable[[Signal, str], Traceable]:
    """Makes an effect of a size: a share of what is a large deflection in the unit of its input."""
    return lambda signal, label: kind(
        signal.name, signal.unit, share * large_input(signal.unit), label, has_size(signal.unit)
    )


def for_outputs(
    equations: Equations, *makers: Callable[[Signal], Traceable]
) -> tuple[Traceable, ...]:
    """What each maker gives for each output that has no instance yet."""
    outputs = further_outputs(equations)
    return tuple(make(signal) for make in makers for signal in outputs)


def large_input(unit: str) -> float:
    """What is a large deflection in a unit; one where nothing is known of it: such an effect takes
    the record's own (``input_peak``).
    """
    return _LARGE_INPUT.get(unit, 1.0)


def has_size(unit: str) -> bool:
    """Whether it is known beforehand what is large in the unit of an input."""
    return unit in _LARGE_INPUT


def has_output_size(unit: str) -> bool:
    """Whether it is known beforehand what is large in the unit of an output."""
    return unit in _LARGE_OUTPUT


def in_its_unit(effect: object, equations: Equations) -> bool:
    """Whether the input, output and ports that an effect acts on are counted in the units that it
    is written for.
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
    through = all(
        ports.get(port) == PORT_UNITS[port] for port in ports_needed(effect) if port in PORT_UNITS
    )
    return through and (name not in units or wanted == units[name])


def large_output(unit: str) -> float:
    """What is a large reading in a unit; one where nothing is known of it."""
    return _LARGE_OUTPUT.get(unit, 1.0)


def per(unit: str) -> str:
    """One over a unit."""
    return f"1/({unit})" if "/" in unit or " " in unit else f"1/{unit}"


def per_square(unit: str) -> str:
    """One over the square of a unit."""
    return f"1/({unit})/({unit})" if "/" in unit or " " in unit else f"1/{unit}2"


def load_ports(equations: Equations) -> tuple[Signal, ...]:
    """Ports that take loads."""
    return tuple(port for port in equations.ports if port.name not in AIR)


def ports_without(listed: Iterable[Traceable], equations: OwnEquations) -> tuple[Signal, ...]:
    """Ports of a user's own model that take loads and on which none of some listed effects acts."""
    known, ports = {*equations.parameter_names}, {port.name for port in equations.ports}
    acting = (
        effect
        for effect in listed
        if known.issuperset(constants_needed(effect)) and ports.issuperset(ports_needed(effect))
    )
    covered = {port for effect in acting for port in ports_needed(effect)}
    return tuple(port for port in load_ports(equations) if port.name not in covered)


def per_unit(port: str, *signals: str) -> str:
    """The unit of a slope by the product of some signals: what a port is counted in over their
    units, ``m/s2/(m/s)/N``.
    """
    below = (f"({unit})" if "/" in unit or " " in unit else unit for unit in signals if unit != "1")
    return "/".join((port, *below))


# ---- What to fly to tell effects apart, where several effects share the advice

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
    "evenly with a signal, all that a record shows is the "
    "product of two signals, whichever of the two derivatives it is"
)
