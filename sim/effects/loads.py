"""Added loads: parameters named after the ports they add to."""

from __future__ import annotations

from collections.abc import Sequence

from sim.declaration.parameters import Parameter

LOADS = ("lift", "moment")


def load_parameters(sizes: Sequence[float], units: Sequence[str], ports: Sequence[str] = LOADS) -> tuple[Parameter, ...]:
    """One parameter for each of some ports, named after it, with a usual size in its unit."""
    return tuple(Parameter(name, size, unit) for name, size, unit in zip(ports, sizes, units, strict=True))


# Coefficients by port, of the aircraft and of the low-order equivalent system; the end of a derivative's name and its signal by what it multiplies.
_COEFFICIENTS = {"lift": ("CL", "L"), "moment": ("Cm", "M"), "side_force": ("CY",), "roll": ("Cl",), "yaw": ("Cn",)}
_MULTIPLIED = {
    **{"alpha_air": ("alpha", "alpha"), "q_hat": ("q", "q"), "q": ("q", "q"), "elevator": ("de", "elevator"), "delta": ("delta", "delta")},
    **{"beta_air": ("beta", "beta"), "p_hat": ("p", "p"), "r_hat": ("r", "r"), "aileron": ("da", "aileron"), "rudder": ("dr", "rudder")},
}


def also_varying(ports: Sequence[str], first: str, second: str) -> tuple[str, ...]:
    """Derivatives that vary with a signal and add the product of two signals to some ports: either derivative over the other's signal."""
    (one, over), (other, under) = _MULTIPLIED[first], _MULTIPLIED[second]
    axes = [axis for port in ports for axis in _COEFFICIENTS[port]]
    return tuple(dict.fromkeys(name for axis in axes for name in (f"varies:{axis}_{one}({under})", f"varies:{axis}_{other}({over})")))
