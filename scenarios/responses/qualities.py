"""Flying qualities from estimated responses and fitted forms: quantities, levels, tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any

from ident.flying_qualities.attitude_criteria import (
    LARGEST_DROOP,
    PILOT_DELAY,
    PITCH_SOURCE,
    AttitudeCurve,
    Bandwidth,
    BandwidthQuantity,
    NealSmith,
    PilotDemand,
    attitude_bandwidth,
    attitude_curve,
    dropback,
    neal_smith,
    pitch_bandwidth_level,
    pitch_overshoot,
)
from ident.flying_qualities.levels import (
    CATEGORIES,
    CLASSES,
    Quality,
    QualityLevel,
    form_levels,
    form_qualities,
)
from ident.flying_qualities.stability_margins import NORMAL_HALF_WIDTH
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.transfer_function import FORMS, Form
from scenarios.report.document import BY_ROW, Column, Table, formatted, table
from scenarios.responses.fitting import Fits, target_of
from scenarios.responses.reading import Names
from sim.errors import DeclarationError

RATE = "rate"  # Kinds of an output.
ATTITUDE = "attitude"
PITCH = "pitch"  # the fitted form whose levels depend on the airspeed


@dataclass(frozen=True)
class LevelOptions:
    """Aircraft class and flight-phase category for the levels of fitted forms.

    Attributes
    ----------
    flown : ``CLASS-CATEGORY``, class I, II-C, II-L, III or IV and category A, B or C of the flight
        phase, as in ``IV-A``; None: no levels.
    airspeed : m/s, for n/alpha and CAP.
    """

    flown: str | None = None
    airspeed: float | None = None

    def __post_init__(self) -> None:
        if self.flown is not None and self.parts not in product(CLASSES, CATEGORIES):
            available = f"{', '.join(CLASSES)} and {', '.join(CATEGORIES)}"
            what = f"{self.flown!r} is no class and category"
            raise DeclarationError(
                what, where="--levels", remedy=f"write CLASS-CATEGORY of {available}, as in IV-A"
            )
        if self.airspeed is not None and not (self.airspeed > 0.0 and math.isfinite(self.airspeed)):
            what = f"{self.airspeed:g} m/s is no airspeed"
            raise DeclarationError(what, where="--airspeed", remedy="give a positive number")

    @property
    def parts(self) -> tuple[str, str]:
        """Class and category."""
        head, _, tail = (self.flown or "").rpartition("-")
        return head, tail

    def refuse_unused(self, fits: Fits | None) -> None:
        """Raise DeclarationError if no fit uses these options."""
        forms = [each.form.name for each in fits.fit.functions] if fits is not None else []
        if self.flown is not None and not any(name in FORMS for name in forms):
            remedy = f"add --fit with one of {', '.join(FORMS)}"
            raise DeclarationError(
                "no form is fitted that has levels", where="--levels", remedy=remedy
            )
        if self.airspeed is not None and PITCH not in forms:
            raise DeclarationError(
                "no pitch rate is fitted", where="--airspeed", remedy="add --fit pitch"
            )


NO_LEVELS = LevelOptions()


def pilot_demand(bandwidth: float | None, delay: float | None) -> PilotDemand | None:
    """Task of the pilot; None without a bandwidth.

    Raises DeclarationError for wrong numbers, or for a delay without a bandwidth.
    """
    if bandwidth is None:
        if delay is not None:
            remedy = "add --pilot RAD/S, the closed-loop bandwidth"
            raise DeclarationError("there is no pilot", where="--pilot-delay", remedy=remedy)
        return None
    delay_seconds = PILOT_DELAY if delay is None else delay
    for option, value, fine in (
        ("--pilot", bandwidth, bandwidth > 0.0),
        ("--pilot-delay", delay_seconds, delay_seconds >= 0.0),
    ):
        if not (fine and math.isfinite(value)):
            raise DeclarationError(f"{value:g}", where=option, remedy="give a positive number")
    return PilotDemand(bandwidth, delay_seconds)


@dataclass(frozen=True, eq=False)
class Qualities:
    """Flying qualities of one response.

    Attributes
    ----------
    name : of the response.
    place : its row and column.
    bandwidth, curve : where a kind of output is named.
    dropback : where ``pitch`` is fitted, s.
    form : quantities of a fitted form.
    levels : of these, where limits are requested.
    overshoot : of the pitch rate after a step, largest over steady.
    pilot : of Neal and Smith, or why there is none.
    flown : class and category of the levels.
    of_pitch : whether it is a response in pitch, by the fitted form or the name of the channel;
        None if neither says so.
    """

    name: str
    place: tuple[int, int]
    bandwidth: Bandwidth | None
    curve: AttitudeCurve | None
    dropback: BandwidthQuantity | None
    form: tuple[Quality, ...] = ()
    levels: tuple[QualityLevel, ...] = ()
    overshoot: BandwidthQuantity | None = None
    pilot: NealSmith | str | None = None
    flown: tuple[str, str] | None = None
    of_pitch: bool | None = None

    @property
    def numbers(self) -> Mapping[str, tuple[BandwidthQuantity, str]]:
        """The determined quantities with their units."""
        result: dict[str, tuple[BandwidthQuantity | None, str]] = {}
        if self.bandwidth is not None:
            result |= {
                "bandwidth": (self.bandwidth.bandwidth, "rad/s"),
                "phase_bandwidth": (self.bandwidth.phase, "rad/s"),
                "gain_bandwidth": (self.bandwidth.gain, "rad/s"),
                "neutral_frequency": (self.bandwidth.neutral, "rad/s"),
                "phase_delay": (self.bandwidth.delay, "s"),
            }
        result["dropback"] = (self.dropback, "s")
        result["pitch_rate_overshoot"] = (self.overshoot, "1")
        if isinstance(self.pilot, NealSmith):
            result["pilot_resonance"] = (self.pilot.resonance, "dB")
            result["pilot_compensation"] = (self.pilot.compensation, "deg")
        result |= {
            each.name: (BandwidthQuantity(each.value, each.std), each.unit) for each in self.form
        }
        return {name: (each, unit) for name, (each, unit) in result.items() if each is not None}

    @property
    def lines(self) -> list[str]:
        """Levels and undetermined quantities, one sentence each."""
        out = []
        for level in self.levels:
            name = quality_name(level.quality.name)
            reached = level_text(level.level, level.best, level.worst)
            out.append(f"{self.name}: {name}: {reached} ({level.criterion.source})")
        out += [f"{self.name}: {line}" for line in _chart_lines(self)]
        notes = self.bandwidth.notes if self.bandwidth is not None else ()
        return out + [f"{self.name}: {note}" for note in notes]


_QUALITY_NAMES = {
    "neutral_frequency": "phase of -180 deg",
    "dropback": "dropback over steady rate",
    "pitch_rate_overshoot": "largest over steady pitch rate",
    "pilot_resonance": "resonance of Neal and Smith's closed loop",
    "pilot_compensation": "phase of Neal and Smith's pilot",
    "load_factor_slope": "n/alpha",
    "control_anticipation": "CAP",
    "total_delay": "equivalent delay",
}


def quality_name(name: str) -> str:
    """Name of a quantity of ``Qualities.numbers`` in tables and sentences."""
    return _QUALITY_NAMES.get(name, name.replace("_", " "))


@dataclass(frozen=True)
class ChartLevel:
    """The level that two quantities reach on the chart of a criterion.

    Attributes
    ----------
    name : of the criterion.
    words : what is judged.
    level : 1 to 4, 4 outside all;
    best, worst : within two standard deviations.
    source : of the limits.
    """

    name: str
    words: str
    level: int
    best: int
    worst: int
    source: str


_PITCH_CHANNELS = ("q", "theta", "alpha", "nz")
_OTHER_CHANNELS = ("p", "r", "phi", "psi", "beta", "ny")


def is_pitch(output: str, form: str) -> bool | None:
    """Return whether a response is one in pitch, by its fitted form ("" for none), else by the name
    of the output; None if neither says so.
    """
    if form in FORMS:
        return form == PITCH
    return True if output in _PITCH_CHANNELS else False if output in _OTHER_CHANNELS else None


def if_pitch(one: Qualities) -> str:
    """``", if this is pitch"`` where it is unknown whether a response is one in pitch."""
    return ", if this is pitch" if one.of_pitch is None else ""


def chart_levels(one: Qualities) -> list[ChartLevel]:
    """Levels of bandwidth and phase delay, and of Neal and Smith's pilot, where they are known;
    none of a response that is not in pitch.
    """
    out = []
    band = one.bandwidth
    if one.of_pitch is False:
        return []  # all charts have limits of pitch
    in_category_a = one.flown is not None and one.flown[1] == "A"
    if in_category_a and band is not None and band.bandwidth is not None and band.delay is not None:
        width, delay = band.bandwidth, band.delay
        best, worst = (
            pitch_bandwidth_level(
                width.value - sign * 2.0 * width.std, max(delay.value + sign * 2.0 * delay.std, 0.0)
            )
            for sign in (-1.0, 1.0)
        )
        words = f"bandwidth and phase delay{if_pitch(one)}"
        level = pitch_bandwidth_level(width.value, delay.value)
        out.append(ChartLevel("bandwidth_and_phase_delay", words, level, best, worst, PITCH_SOURCE))
    result = one.pilot
    if isinstance(result, NealSmith) and result.droop >= LARGEST_DROOP - 0.05:
        words = (
            f"resonance at {result.demand.bandwidth:g} rad/s, delay {result.demand.delay:g} s"
            f"{if_pitch(one)}"
        )
        source = "MIL-STD-1797A, 4.2.1.2, closed-loop criterion"
        out.append(
            ChartLevel("pilot_resonance", words, result.level, result.best, result.worst, source)
        )
    return out


def _chart_lines(one: Qualities) -> list[str]:
    """Return the levels of criteria with two quantities, and the pilot's compensation."""
    out = [
        f"{each.words}: {level_text(each.level, each.best, each.worst)} ({each.source})"
        for each in chart_levels(one)
    ]
    if isinstance(one.pilot, str):
        out.append(one.pilot)
    elif one.pilot is not None:
        out += one.pilot.notes
    return out


def level_text(level: int, best: int, worst: int) -> str:
    """``"level 1; 1 to 2 within two sigmas"``."""
    reached = f"level {level}" if level < 4 else "outside level 3"
    if best == worst:
        return reached
    return f"{reached}; {best} to {worst if worst < 4 else 'outside 3'} within two sigmas"


def refuse_kind(kind: str | None) -> None:
    """Raise DeclarationError for an unknown kind of output."""
    if kind not in (None, RATE, ATTITUDE):
        remedy = f"say {RATE} or {ATTITUDE}, what the outputs are"
        raise DeclarationError(f"there is no kind {kind!r}", where="--bandwidth", remedy=remedy)


def no_rate(form: Form, unit: str) -> bool:
    """Return whether a form of a pitch rate was fitted to an output with the unit of another
    quantity, such as an angle; an output without a unit may be a rate.
    """
    return form.name == PITCH and unit not in ("", "1") and not unit.endswith(("rad/s", "deg/s"))


def form_cautions(fits: Fits | None, names: Names, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return cautions on forms that were fitted to outputs of another kind."""
    if fits is None:
        return ()
    out = []
    for (row, _), function in zip(fits.places, fits.fit.functions, strict=True):
        name = names.outputs[row]
        if no_rate(function.form, units.get(name, "")):
            out.append(
                f"{function.name}: the form pitch is that of a pitch rate, and {name} is in "
                f"{units[name]}; take --fit {name}=dutch-roll for an angle of attack, else orders "
                "such as 1/2"
            )
    return tuple(out)


def qualities_of(
    responses: FrequencyResponses,
    names: Names,
    kind: str | None,
    fits: Fits | None,
    limits: LevelOptions = NO_LEVELS,
    pilot: PilotDemand | None = None,
    units: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Qualities, ...]:
    """Return the flying qualities of every response with a usable band.

    ``kind``: of outputs, rate or attitude; None: no bandwidth and phase delay. ``limits``: of
    levels of fitted forms. ``pilot``: of the Neal-Smith criterion. ``units``: of the signals;
    what holds for a pitch rate is not computed of an output that is none.
    """
    limits.refuse_unused(fits)
    if pilot is not None and kind is None:
        remedy = f"say what the outputs are with --bandwidth, {RATE} or {ATTITUDE}"
        raise DeclarationError("a pilot needs an attitude", where="--pilot", remedy=remedy)
    out = []
    # If there is also a pitch rate, a second-order response is that of the angle of attack.
    lateral = fits is None or all(each.form.name != PITCH for each in fits.fit.functions)
    for row, output in enumerate(names.outputs):
        for column, one in enumerate(names.inputs):
            fitted = fits.of(row, column) if fits is not None else None
            if fitted is not None and no_rate(fitted[0].form, units.get(output, "")):
                fitted = None
            fall = dropback(fitted[0]) if fitted is not None else None
            bandwidth = curve = None
            name = f"{output}/{one}"
            if kind is not None and responses.usable[row, column].any():
                target = target_of(responses, (row, column), name)
                bandwidth = attitude_bandwidth(target, rate=kind == RATE)
                curve = attitude_curve(target, rate=kind == RATE)
            form = (
                form_qualities(fitted[0], limits.airspeed, dutch_roll=lateral)
                if fitted is not None
                else ()
            )
            levels = form_levels(form, *limits.parts) if limits.flown is not None else ()
            form = form if limits.flown is not None or limits.airspeed is not None else ()
            if bandwidth is not None or fall is not None or form:
                over = pitch_overshoot(fitted[0]) if fitted is not None else None
                closed = neal_smith(curve, pilot) if curve is not None and pilot else None
                flight_phase = limits.parts if limits.flown is not None else None
                place = (row, column)
                out.append(
                    Qualities(
                        *(
                            name,
                            place,
                            bandwidth,
                            curve,
                            fall,
                            form,
                            levels,
                            over,
                            closed,
                            flight_phase,
                        ),
                        is_pitch(output, fitted[0].form.name if fitted is not None else ""),
                    )
                )
    return tuple(out)


def quality_table(one: Qualities) -> Table | None:
    """Return the numbers of one response with their 95 % intervals; None if there are none."""
    if not one.numbers:
        return None
    rows = [(quality_name(name), each, unit) for name, (each, unit) in one.numbers.items()]
    hertz = [
        formatted(each.value / (2.0 * math.pi), ".3g") if unit == "rad/s" else ""
        for _, each, unit in rows
    ]
    return table(
        f"Flying qualities of {one.name}, with 95 % intervals",
        (Column("quantity"), [name for name, _, _ in rows]),
        (Column("value", BY_ROW), [formatted(each.value, ".3g") for _, each, _ in rows]),
        (
            Column("+-", BY_ROW, beside=True),
            [formatted(NORMAL_HALF_WIDTH * each.std, ".2g") for _, each, _ in rows],
        ),
        (Column("frequency", "Hz"), hertz) if any(hertz) else None,
        units=["" if unit == "1" else unit for _, _, unit in rows],
    )


def quality_tables(qualities: Sequence[Qualities]) -> list[Table]:
    """Flying qualities, a table for each response that has some."""
    return [each for each in map(quality_table, qualities) if each is not None]


def quality_lines(qualities: Sequence[Qualities]) -> list[str]:
    """Return the levels and undetermined flying qualities, one sentence each."""
    return [line for each in qualities for line in each.lines]


def levels_by_name(qualities: Sequence[Qualities]) -> dict[str, dict[str, tuple[int, int, int]]]:
    """Level, best and worst within two standard deviations by response and quantity or chart."""
    result = {
        each.name: {
            **{one.quality.name: (one.level, one.best, one.worst) for one in each.levels},
            **{one.name: (one.level, one.best, one.worst) for one in chart_levels(each)},
        }
        for each in qualities
    }
    return {name: levels for name, levels in result.items() if levels}


def levels_content(one: Qualities) -> list[dict[str, Any]]:
    """Return the levels of quantities and of charts for ``responses.json``."""
    return [
        *(
            _level_row(each.quality.name, each, each.criterion.source)
            | {"category": each.criterion.category}
            for each in one.levels
        ),
        *(_level_row(each.name, each, each.source) for each in chart_levels(one)),
    ]


def _level_row(name: str, reached: QualityLevel | ChartLevel, source: str) -> dict[str, Any]:
    return {
        "quantity": name,
        "level": reached.level,
        "best": reached.best,
        "worst": reached.worst,
        "source": source,
    }
