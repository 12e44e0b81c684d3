"""Flying qualities from estimated responses: bandwidth, phase delay, dropback, in words and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ident.flying_qualities.bandwidth import (
    AttitudeCurve,
    Bandwidth,
    Quantity,
    attitude_bandwidth,
    attitude_curve,
    dropback,
)
from ident.frequency_response import FrequencyResponses
from scenarios.responses.fitting import Fits, target_of
from scenarios.responses.reading import Names
from sim.errors import DeclarationError

RATE, ATTITUDE = "rate", "attitude"
LEVEL = 1.959964  # standard deviations of a 95 % interval


@dataclass(frozen=True, eq=False)
class Qualities:
    """Flying qualities of one response.

    Attributes
    ----------
    name : of the response. place : its row and column.
    bandwidth, curve : where a kind of output is named. dropback : where ``pitch`` is fitted, s.
    """

    name: str
    place: tuple[int, int]
    bandwidth: Bandwidth | None
    curve: AttitudeCurve | None
    dropback: Quantity | None

    @property
    def numbers(self) -> Mapping[str, tuple[Quantity, str]]:
        """Quantities that are known, with their units."""
        found: dict[str, tuple[Quantity | None, str]] = {}
        if self.bandwidth is not None:
            found |= {
                "bandwidth": (self.bandwidth.bandwidth, "rad/s"),
                "phase_bandwidth": (self.bandwidth.phase, "rad/s"),
                "gain_bandwidth": (self.bandwidth.gain, "rad/s"),
                "neutral_frequency": (self.bandwidth.neutral, "rad/s"),
                "phase_delay": (self.bandwidth.delay, "s"),
            }
        found["dropback"] = (self.dropback, "s")
        return {name: (each, unit) for name, (each, unit) in found.items() if each is not None}

    @property
    def lines(self) -> list[str]:
        """A sentence for each quantity, and for what is not known."""
        words = {"neutral_frequency": "phase of -180 deg", "dropback": "dropback over steady rate"}
        out = []
        for name, (each, unit) in self.numbers.items():
            half = LEVEL * each.std
            hertz = f" ({each.value / (2.0 * math.pi):.3g} Hz)" if unit == "rad/s" else ""
            said = words.get(name, name.replace("_", " "))
            out.append(f"{self.name}: {said} {each.value:.3g} +- {half:.2g} {unit}{hertz}, 95 %")
        notes = self.bandwidth.notes if self.bandwidth is not None else ()
        return out + [f"{self.name}: {note}" for note in notes]


def refuse_kind(kind: str | None) -> None:
    """Raise DeclarationError for what is no kind of output."""
    if kind not in (None, RATE, ATTITUDE):
        remedy = f"say {RATE} or {ATTITUDE}, what the outputs are"
        raise DeclarationError(f"there is no kind {kind!r}", where="--bandwidth", remedy=remedy)


def qualities_of(found: FrequencyResponses, names: Names, kind: str | None, fits: Fits | None) -> tuple[Qualities, ...]:
    """Flying qualities of every response with a usable band; ``kind`` : of the outputs, rate or
    attitude; None leaves bandwidth and phase delay out."""
    out = []
    for row, output in enumerate(names.outputs):
        for column, one in enumerate(names.inputs):
            fitted = fits.of(row, column) if fits is not None else None
            fall = dropback(fitted[0]) if fitted is not None else None
            bandwidth = curve = None
            name = f"{output}/{one}"
            if kind is not None and found.usable[row, column].any():
                target = target_of(found, (row, column), name)
                bandwidth = attitude_bandwidth(target, rate=kind == RATE)
                curve = attitude_curve(target, rate=kind == RATE)
            if bandwidth is not None or fall is not None:
                out.append(Qualities(name, (row, column), bandwidth, curve, fall))
    return tuple(out)
