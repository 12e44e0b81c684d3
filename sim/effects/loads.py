"""Added loads: parameters named after the ports they add to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from sim.declaration.parameters import Parameter

LOADS = ("lift", "moment")


class SizedOnPorts:
    """What terms share that have one size for each port that they load: a parameter of the port's name, absent where all are zero."""

    ports: tuple[str, ...]

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.ports, 0.0))


def load_parameters(sizes: Sequence[float], units: Sequence[str], ports: Sequence[str] = LOADS) -> tuple[Parameter, ...]:
    """One parameter for each of some ports, named after it, with a usual size in its unit."""
    return tuple(Parameter(name, size, unit) for name, size, unit in zip(ports, sizes, units, strict=True))


# Coefficients by port, of the aircraft and of the low-order equivalent system.
_COEFFICIENTS = {"lift": ("CL", "L"), "moment": ("Cm", "M"), "side_force": ("CY",), "roll": ("Cl",), "yaw": ("Cn",)}
# The signal that a derivative of the built-in models multiplies, by what stands behind its underscore; and that end, by the signal on the bus.
MULTIPLIED = {
    **{"alpha": "alpha", "q": "q", "V": "airspeed", "beta": "beta", "p": "p", "r": "r"},
    **{"de": "elevator", "da": "aileron", "dr": "rudder", "delta": "delta"},
}
_ENDS = {signal: end for end, signal in MULTIPLIED.items()} | {"alpha_air": "alpha", "q_hat": "q", "beta_air": "beta", "p_hat": "p", "r_hat": "r"}


def also_varying(ports: Sequence[str], first: str, second: str) -> tuple[str, ...]:
    """Derivatives that vary with a signal and add the product of two signals to some ports: either derivative over the other's signal.

    None where the signals are those of a user's own model, whose parameters have any names.
    """
    if not {first, second} <= {*_ENDS} or not {*ports} <= {*_COEFFICIENTS}:
        return ()
    one, other = _ENDS[first], _ENDS[second]
    over, under = MULTIPLIED[one], MULTIPLIED[other]
    axes = [axis for port in ports for axis in _COEFFICIENTS[port]]
    return tuple(dict.fromkeys(name for axis in axes for name in (f"varies:{axis}_{one}({under})", f"varies:{axis}_{other}({over})")))
