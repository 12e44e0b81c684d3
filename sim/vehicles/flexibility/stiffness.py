"""The same aircraft with a stiffer or softer structure: all modal frequencies by one factor."""

from __future__ import annotations

import math
from dataclasses import replace

from sim.errors import DeclarationError
from sim.vehicles.data import Origin, VehicleData


def with_frequency_factor(data: VehicleData, factor: float) -> VehicleData:
    """A vehicle whose in-vacuo modal frequencies are ``factor`` times those of ``data``, masses, shapes and damping ratios alike.

    Modal stiffness goes with the square of it; a large factor is a rigid aircraft. At 1 it is the same object.

    Raises
    ------
    DeclarationError : a factor that is not above zero, or a vehicle without elastic modes and a factor other than one.
    """
    if factor == 1.0:
        return data
    if not (factor > 0.0 and math.isfinite(factor)):
        raise DeclarationError(f"a frequency factor of {factor:g}", where=f"vehicle {data.name}", remedy="give a number above zero")
    if not data.modes:
        raise DeclarationError("it has no modal frequencies", where=f"vehicle {data.name}", remedy="leave the frequency factor out")
    scaled = {f"omega{i}" for i in range(1, data.modes + 1)}
    note = f"{factor:g} times that of {data.name}"
    return replace(
        data,
        numbers=tuple(
            replace(number, value=factor * number.value, origin=Origin.OWN, note=note) if number.name in scaled else number for number in data.numbers
        ),
    )
