"""Added loads: parameters named after the ports they add to."""

from __future__ import annotations

from collections.abc import Sequence

from sim.declaration.parameters import Parameter

LOADS = ("lift", "moment")


def load_parameters(sizes: Sequence[float], units: Sequence[str], ports: Sequence[str] = LOADS) -> tuple[Parameter, ...]:
    """One parameter for each of some ports, named after it, with a usual size in its unit."""
    return tuple(Parameter(name, size, unit) for name, size, unit in zip(ports, sizes, units, strict=True))
