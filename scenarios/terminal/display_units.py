"""The one unit in which each quantity is shown: in tables, on pages and at the axes of figures.

| quantity | shown in |
|---|---|
| angles, their rates | deg, deg/s, deg/s2 |
| frequencies | rad/s, with Hz beside |
| derivatives, trims of the equations (L_0, M_0) and everything else | the unit that it has: 1/rad, rad/s, s, g, m/s |

Inside and in JSON and CSV files everything is SI, load factors in g.
"""

from __future__ import annotations

import math
from typing import NamedTuple

DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2", "rad/s/s": "deg/s2"}
NO_UNIT = ("", "1")
LOADS = ("L_0", "M_0")  # loads over mass and inertia, read beside the derivatives and not as rates


class Shown(NamedTuple):
    """How a quantity is shown: ``factor`` times its number, in ``unit``."""

    factor: float
    unit: str


def shown_in(unit: str, name: str = "") -> Shown:
    """How a quantity of ``unit`` is shown; its ``name`` tells a frequency, which nobody reads in deg/s, from a rate."""
    if unit in DEGREES and name not in LOADS and not is_frequency(name, unit):
        return Shown(180.0 / math.pi, DEGREES[unit])
    return Shown(1.0, unit)


def told(value: float, unit: str, name: str = "") -> str:
    """A number without a sigma as it is shown: ``"0.5 deg"``, ``"12 rad/s (1.91 Hz)"``."""
    factor, shown = shown_in(unit, name)
    return f"{factor * value:.5g}{spaced(shown)}{in_hertz(value, name, unit)}"


def is_frequency(name: str, unit: str) -> bool:
    """Whether a quantity of ``unit`` is a frequency by its name: ``frequency``, ``natural_frequency``, ``omega1``."""
    return unit == "rad/s" and ("frequency" in name or name.rpartition(".")[2].rstrip("0123456789") == "omega")


def in_hertz(value: float, name: str, unit: str) -> str:
    """``" (1.91 Hz)"`` behind a frequency in rad/s, nothing behind anything else."""
    return f" ({value / (2.0 * math.pi):.3g} Hz)" if is_frequency(name, unit) else ""


def unit_cell(unit: str) -> str:
    """A unit in a column of units: nothing for a pure number."""
    return unit if unit not in NO_UNIT else ""


def spaced(unit: str) -> str:
    """A unit behind its number: a blank and the unit, nothing for a pure number."""
    return f" {unit}" if unit not in NO_UNIT else ""
