"""What NASA TM-101722 prints of its low-order equivalents; only shown beside estimates, never used to form them."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from importlib.resources import files

from sim.errors import DeclarationError

FILE = "short_period_dynamics.toml"


@dataclass(frozen=True)
class Printed:
    """A printed value and the standard deviation from its printed final variance, None where none is printed."""

    value: float
    std: float | None


def printed_column(name: str) -> dict[str, Printed]:
    """A column of the paper's tables, SI, control derivatives with the sign turned. Raises DeclarationError when there is none."""
    document = tomllib.loads(files("scenarios.studies.published").joinpath(FILE).read_text(encoding="utf-8"))
    table = document["loes"]
    if name not in table:
        raise DeclarationError(f"there is no column {name!r}", where=f"published {FILE}", remedy=f"use one of {', '.join(table)}")
    return {key: Printed(float(e["value"]), math.sqrt(e["variance"]) if "variance" in e else None) for key, e in table[name].items()}
