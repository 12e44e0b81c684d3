"""Flying qualities from estimated responses: bandwidth, phase delay, dropback, in words and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

from ident.flying_qualities.bandwidth import AttitudeCurve, Bandwidth, BandwidthQuantity, attitude_bandwidth, attitude_curve, dropback
from ident.flying_qualities.fitted_forms import form_levels, form_qualities
from ident.flying_qualities.levels import CATEGORIES, CLASSES, Level, Quality
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.transfer_function import FORMS
from scenarios.responses.fitting import Fits, target_of
from scenarios.responses.reading import Names
from sim.errors import DeclarationError

RATE, ATTITUDE = "rate", "attitude"
PITCH = "pitch"  # the form that airspeed belongs to
LEVEL = 1.959964  # standard deviations of a 95 % interval


@dataclass(frozen=True)
class LevelOptions:
    """Against which limits fitted forms are held.

    Attributes
    ----------
    flown : ``CLASS-CATEGORY``, class I, II-C, II-L, III or IV and category A, B or C of the flight
        phase, as in ``IV-A``; None judges nothing. airspeed : m/s, for n/alpha and CAP.
    """

    flown: str | None = None
    airspeed: float | None = None

    def __post_init__(self) -> None:
        if self.flown is not None and self.parts not in product(CLASSES, CATEGORIES):
            known = f"{', '.join(CLASSES)} and {', '.join(CATEGORIES)}"
            what = f"{self.flown!r} is no class and category"
            raise DeclarationError(what, where="--levels", remedy=f"write CLASS-CATEGORY of {known}, as in IV-A")
        if self.airspeed is not None and not (self.airspeed > 0.0 and math.isfinite(self.airspeed)):
            what = f"{self.airspeed:g} m/s is no airspeed"
            raise DeclarationError(what, where="--airspeed", remedy="give a positive number")

    @property
    def parts(self) -> tuple[str, str]:
        """Class and category."""
        head, _, tail = (self.flown or "").rpartition("-")
        return head, tail

    def refuse_unused(self, fits: Fits | None) -> None:
        """Raise DeclarationError where nothing is fitted that the options are for."""
        forms = [each.form.name for each in fits.fit.functions] if fits is not None else []
        if self.flown is not None and not any(name in FORMS for name in forms):
            remedy = f"add --fit with one of {', '.join(FORMS)}"
            raise DeclarationError("no form is fitted that has levels", where="--levels", remedy=remedy)
        if self.airspeed is not None and PITCH not in forms:
            raise DeclarationError("no pitch rate is fitted", where="--airspeed", remedy="add --fit pitch")


NO_LEVELS = LevelOptions()


@dataclass(frozen=True, eq=False)
class Qualities:
    """Flying qualities of one response.

    Attributes
    ----------
    name : of the response. place : its row and column.
    bandwidth, curve : where a kind of output is named. dropback : where ``pitch`` is fitted, s.
    form : quantities of a fitted form. levels : of these, where limits are asked for.
    """

    name: str
    place: tuple[int, int]
    bandwidth: Bandwidth | None
    curve: AttitudeCurve | None
    dropback: BandwidthQuantity | None
    form: tuple[Quality, ...] = ()
    levels: tuple[Level, ...] = ()

    @property
    def numbers(self) -> Mapping[str, tuple[BandwidthQuantity, str]]:
        """Quantities that are known, with their units."""
        found: dict[str, tuple[BandwidthQuantity | None, str]] = {}
        if self.bandwidth is not None:
            found |= {
                "bandwidth": (self.bandwidth.bandwidth, "rad/s"),
                "phase_bandwidth": (self.bandwidth.phase, "rad/s"),
                "gain_bandwidth": (self.bandwidth.gain, "rad/s"),
                "neutral_frequency": (self.bandwidth.neutral, "rad/s"),
                "phase_delay": (self.bandwidth.delay, "s"),
            }
        found["dropback"] = (self.dropback, "s")
        found |= {each.name: (BandwidthQuantity(each.value, each.std), each.unit) for each in self.form}
        return {name: (each, unit) for name, (each, unit) in found.items() if each is not None}

    @property
    def lines(self) -> list[str]:
        """A sentence for each quantity, and for what is not known."""
        words = {
            "neutral_frequency": "phase of -180 deg",
            "dropback": "dropback over steady rate",
            "load_factor_slope": "n/alpha",
            "control_anticipation": "CAP",
            "total_delay": "equivalent delay",
        }
        out = []
        for name, (each, unit) in self.numbers.items():
            half = LEVEL * each.std
            hertz = f" ({each.value / (2.0 * math.pi):.3g} Hz)" if unit == "rad/s" else ""
            said = words.get(name, name.replace("_", " "))
            shown = "" if unit == "1" else f" {unit}"
            out.append(f"{self.name}: {said} {each.value:.3g} +- {half:.2g}{shown}{hertz}, 95 %")
        for level in self.levels:
            said = words.get(level.quality.name, level.quality.name.replace("_", " "))
            reached = f"level {level.level}" if level.level < 4 else "outside level 3"
            between = f"; {level.best} to {level.worst} within two sigmas" if level.uncertain else ""
            out.append(f"{self.name}: {said}: {reached}{between} ({level.criterion.source})")
        notes = self.bandwidth.notes if self.bandwidth is not None else ()
        return out + [f"{self.name}: {note}" for note in notes]


def refuse_kind(kind: str | None) -> None:
    """Raise DeclarationError for what is no kind of output."""
    if kind not in (None, RATE, ATTITUDE):
        remedy = f"say {RATE} or {ATTITUDE}, what the outputs are"
        raise DeclarationError(f"there is no kind {kind!r}", where="--bandwidth", remedy=remedy)


def qualities_of(
    found: FrequencyResponses,
    names: Names,
    kind: str | None,
    fits: Fits | None,
    limits: LevelOptions = NO_LEVELS,
) -> tuple[Qualities, ...]:
    """Flying qualities of every response with a usable band; ``kind`` : of the outputs, rate or
    attitude; None leaves bandwidth and phase delay out. ``limits`` : of the levels of fitted forms."""
    limits.refuse_unused(fits)
    out = []
    # With a pitch rate beside it a second-order response is that of the angle of attack.
    lateral = fits is None or all(each.form.name != PITCH for each in fits.fit.functions)
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
            form = form_qualities(fitted[0], limits.airspeed, dutch_roll=lateral) if fitted is not None else ()
            levels = form_levels(form, *limits.parts) if limits.flown is not None else ()
            form = form if limits.flown is not None or limits.airspeed is not None else ()
            if bandwidth is not None or fall is not None or form:
                out.append(Qualities(name, (row, column), bandwidth, curve, fall, form, levels))
    return tuple(out)
