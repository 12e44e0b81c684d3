"""Added loads: parameters named after the ports they add to."""

from __future__ import annotations

from sim.declaration.parameters import Parameter


def load_parameters(sizes: tuple[float, float], units: tuple[str, str]) -> tuple[Parameter, ...]:
    """``lift`` and ``moment``, each with a usual size in its unit."""
    return tuple(Parameter(name, size, unit) for name, size, unit in zip(("lift", "moment"), sizes, units, strict=True))
