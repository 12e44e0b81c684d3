"""Instances of an effect on the inputs and outputs of any equations: what they are called, and what is large in which unit."""

from __future__ import annotations

from collections.abc import Iterable

from sim.declaration.effect import Signal
from sim.declaration.model import Containing, DrivenBeside, Equations

KNOWN_INPUTS, KNOWN_OUTPUTS = ("elevator", "stick"), ("alpha", "q", "nz", "altitude")  # their instances stand in the effects' own files
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
    """Inputs that somebody moves: not those that are measured motion or air, which take the place of a port or of the attitude."""
    others = {ATTITUDE, *(port.name for port in equations.ports), *(equations.no_controls if isinstance(equations, DrivenBeside) else ())}
    return tuple(signal for signal in equations.inputs if signal.name not in others)


def further_inputs(equations: Equations) -> tuple[tuple[Signal, str], ...]:
    """Inputs that need instances of their own, with the label of each: its name where there are several inputs."""
    if isinstance(equations, Containing):
        # What lies between input and vehicle is part of these equations.
        return ()
    moved = controls(equations)
    several = len(moved) > 1
    return tuple((signal, signal.name if several else "") for signal in moved if several or signal.name not in KNOWN_INPUTS)


def further_outputs(equations: Equations) -> tuple[Signal, ...]:
    """Outputs that need instances of their own."""
    return tuple(signal for signal in equations.outputs if signal.name not in KNOWN_OUTPUTS)


def large_input(unit: str) -> float:
    """What is a large deflection in a unit; one where nothing is known of it: such an effect takes the record's own (``input_peak``)."""
    return _LARGE_INPUT.get(unit, 1.0)


def has_size(unit: str) -> bool:
    """Whether it is known beforehand what is large in the unit of an input."""
    return unit in _LARGE_INPUT


def large_output(unit: str) -> float:
    """What is a large reading in a unit; one where nothing is known of it."""
    return _LARGE_OUTPUT.get(unit, 1.0)


def per(unit: str) -> str:
    """One over a unit."""
    return f"1/({unit})" if "/" in unit or " " in unit else f"1/{unit}"


def load_ports(equations: Equations) -> tuple[Signal, ...]:
    """Ports that take loads."""
    return tuple(port for port in equations.ports if port.name not in AIR)
