"""Flying qualities from estimated responses and fitted forms: quantities, levels, tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any

from ident.flying_qualities.attitude_criteria import (
    PITCH_SOURCE,
    AttitudeCurve,
    Bandwidth,
    UncertainValue,
    attitude_bandwidth,
    attitude_curve,
    dropback,
    pitch_bandwidth_level,
    pitch_overshoot,
)
from ident.flying_qualities.fitted_forms import form_levels, form_qualities
from ident.flying_qualities.levels import (
    CATEGORIES,
    CLASSES,
    Quality,
    QualityLevel,
)
from ident.flying_qualities.pilot_in_loop import (
    LARGEST_DROOP,
    PILOT_DELAY,
    NealSmith,
    PilotDemand,
    neal_smith,
)
from ident.flying_qualities.stability_margins import NORMAL_HALF_WIDTH
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.transfer_function import FORMS, Form
from scenarios.report.document import BY_ROW, Column, Table, formatted, table
from scenarios.responses.fitting import Fits, target_of
from scenarios.responses.reading import Names
from sim.errors import DeclarationError

RATE, ATTITUDE = "rate", "attitude"  # kinds of an output
PITCH = "pitch"  # the fitted form whose levels depend on the airspeed
OUTSIDE_LEVELS = 4  # in place of a level: outside level 3
DROOP_TOLERANCE = 0.05  # dB, by which a closed loop may exceed the allowed droop


@dataclass(frozen=True)
class LevelOptions:
    """Aircraft class and flight-phase category for the levels of fitted forms.

    Attributes
    ----------
    flown : ``CLASS-CATEGORY``, as in ``IV-A``: class I, II-C, II-L, III or IV, and category A, B or
        C of the flight phase; None for no levels.
    airspeed : airspeed for n/alpha and CAP, m/s.
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
        """Aircraft class and flight-phase category."""
        aircraft_class, _, category = (self.flown or "").rpartition("-")
        return aircraft_class, category

    def refuse_unused(self, fits: Fits | None) -> None:
        """Raise DeclarationError if no fit uses these options."""
        forms = [function.form.name for function in fits.fit.functions] if fits is not None else []
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
    """Return the task of the pilot; None without a bandwidth.

    Parameters
    ----------
    bandwidth : bandwidth of the closed loop, rad/s.
    delay : delay of the pilot, s; None takes the usual one.

    Raises
    ------
    DeclarationError : a number is impossible, or there is a delay without a bandwidth.
    """
    if bandwidth is None:
        if delay is not None:
            remedy = "add --pilot RAD/S, the closed-loop bandwidth"
            raise DeclarationError("there is no pilot", where="--pilot-delay", remedy=remedy)
        return None
    delay = PILOT_DELAY if delay is None else delay
    for option, value, possible in (
        ("--pilot", bandwidth, bandwidth > 0.0),
        ("--pilot-delay", delay, delay >= 0.0),
    ):
        if not (possible and math.isfinite(value)):
            raise DeclarationError(f"{value:g}", where=option, remedy="give a positive number")
    return PilotDemand(bandwidth, delay)


@dataclass(frozen=True, eq=False)
class Qualities:
    """Flying qualities of one response.

    Attributes
    ----------
    name : name of the response, ``"OUTPUT/INPUT"``.
    place : row (output) and column (input) of the response.
    bandwidth, curve : bandwidth, and the attitude response; None unless a kind of output is named.
    dropback : dropback of the attitude, s; None unless ``pitch`` is fitted.
    form : quantities of a fitted form.
    levels : levels of these quantities, if requested.
    overshoot : pitch rate after a step, largest over steady.
    pilot : result of the Neal-Smith criterion, or the reason why there is none.
    flown : class and category of the levels.
    of_pitch : whether it is a response in pitch, by the fitted form or the name of the channel;
        None if neither says so.
    """

    name: str
    place: tuple[int, int]
    bandwidth: Bandwidth | None
    curve: AttitudeCurve | None
    dropback: UncertainValue | None
    form: tuple[Quality, ...] = ()
    levels: tuple[QualityLevel, ...] = ()
    overshoot: UncertainValue | None = None
    pilot: NealSmith | str | None = None
    flown: tuple[str, str] | None = None
    of_pitch: bool | None = None

    @property
    def numbers(self) -> Mapping[str, tuple[UncertainValue, str]]:
        """The determined quantities with their units."""
        result: dict[str, tuple[UncertainValue | None, str]] = {}
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
            quality.name: (UncertainValue(quality.value, quality.std), quality.unit)
            for quality in self.form
        }
        return {
            name: (quantity, unit)
            for name, (quantity, unit) in result.items()
            if quantity is not None
        }

    @property
    def lines(self) -> list[str]:
        """Levels and undetermined quantities, one sentence each."""
        lines = [
            f"{quality_name(level.quality.name)}: "
            f"{level_text(level.level, level.best, level.worst)} ({level.criterion.source})"
            for level in self.levels
        ]
        lines += _chart_lines(self)
        if self.bandwidth is not None:
            lines += self.bandwidth.notes
        return [f"{self.name}: {line}" for line in lines]


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
    """Return the name of a quantity of ``Qualities.numbers`` for tables and sentences."""
    return _QUALITY_NAMES.get(name, name.replace("_", " "))


@dataclass(frozen=True)
class ChartLevel:
    """The level that two quantities reach on the chart of a criterion.

    Attributes
    ----------
    name : name of the criterion.
    words : the quantities in words.
    level : 1 to 3, or ``OUTSIDE_LEVELS``.
    best, worst : best and worst level within two standard deviations.
    source : source of the limits.
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
    if output in _PITCH_CHANNELS:
        return True
    return False if output in _OTHER_CHANNELS else None


def if_pitch(qualities: Qualities) -> str:
    """Return ``", if this is pitch"`` where it is unknown whether a response is one in pitch."""
    return ", if this is pitch" if qualities.of_pitch is None else ""


def chart_levels(qualities: Qualities) -> list[ChartLevel]:
    """Return the levels of bandwidth with phase delay, and of the Neal-Smith criterion, if known;
    none of a response that is not in pitch.

    Limits of bandwidth and phase delay are known for pitch in category A.
    """
    levels: list[ChartLevel] = []
    if qualities.of_pitch is False:
        return levels
    band = qualities.bandwidth
    in_category_a = qualities.flown is not None and qualities.flown[1] == "A"
    if in_category_a and band is not None and band.bandwidth is not None and band.delay is not None:
        width, delay = band.bandwidth, band.delay
        best, worst = (
            pitch_bandwidth_level(
                width.value - sigmas * width.std, max(delay.value + sigmas * delay.std, 0.0)
            )
            for sigmas in (-2.0, 2.0)
        )
        words = f"bandwidth and phase delay{if_pitch(qualities)}"
        level = pitch_bandwidth_level(width.value, delay.value)
        levels.append(
            ChartLevel("bandwidth_and_phase_delay", words, level, best, worst, PITCH_SOURCE)
        )
    pilot = qualities.pilot
    if isinstance(pilot, NealSmith) and pilot.droop >= LARGEST_DROOP - DROOP_TOLERANCE:
        words = (
            f"resonance at {pilot.demand.bandwidth:g} rad/s, delay {pilot.demand.delay:g} s"
            f"{if_pitch(qualities)}"
        )
        source = "MIL-STD-1797A, 4.2.1.2, closed-loop criterion"
        levels.append(
            ChartLevel("pilot_resonance", words, pilot.level, pilot.best, pilot.worst, source)
        )
    return levels


def _chart_lines(qualities: Qualities) -> list[str]:
    """Return the levels of criteria with two quantities, and notes of the Neal-Smith criterion."""
    lines = [
        f"{chart.words}: {level_text(chart.level, chart.best, chart.worst)} ({chart.source})"
        for chart in chart_levels(qualities)
    ]
    if isinstance(qualities.pilot, str):
        lines.append(qualities.pilot)
    elif qualities.pilot is not None:
        lines += qualities.pilot.notes
    return lines


def level_text(level: int, best: int, worst: int) -> str:
    """Return a level in words: ``"level 1; 1 to 2 within two sigmas"``."""
    text = f"level {level}" if level < OUTSIDE_LEVELS else "outside level 3"
    if best == worst:
        return text
    worst_text = str(worst) if worst < OUTSIDE_LEVELS else "outside 3"
    return f"{text}; {best} to {worst_text} within two sigmas"


def refuse_kind(kind: str | None) -> None:
    """Raise DeclarationError for an unknown kind of output."""
    if kind not in (None, RATE, ATTITUDE):
        remedy = f"say {RATE} or {ATTITUDE}, what the outputs are"
        raise DeclarationError(f"there is no kind {kind!r}", where="--bandwidth", remedy=remedy)


def no_rate(form: Form, unit: str) -> bool:
    """Return whether the form of a pitch rate was fitted to an output that is not a rate.

    The unit decides. An output without a unit may be a rate.
    """
    return form.name == PITCH and unit not in ("", "1") and not unit.endswith(("rad/s", "deg/s"))


def form_cautions(fits: Fits | None, names: Names, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return cautions on forms that were fitted to outputs of another kind."""
    if fits is None:
        return ()
    cautions = []
    for (row, _), function in zip(fits.places, fits.fit.functions, strict=True):
        name = names.outputs[row]
        if no_rate(function.form, units.get(name, "")):
            cautions.append(
                f"{function.name}: the form pitch is that of a pitch rate, and {name} is in "
                f"{units[name]}; take --fit {name}=dutch-roll for an angle of attack, else orders "
                "such as 1/2"
            )
    return tuple(cautions)


def qualities_of(
    responses: FrequencyResponses,
    names: Names,
    kind: str | None,
    fits: Fits | None,
    limits: LevelOptions = NO_LEVELS,
    pilot: PilotDemand | None = None,
    units: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Qualities, ...]:
    """Return the flying qualities of every response that has some.

    Parameters
    ----------
    responses : the frequency responses.
    names : names of outputs and inputs.
    kind : kind of the outputs, rate or attitude; None computes no bandwidth and phase delay.
    fits : fitted forms, or None.
    limits : aircraft class, category and airspeed for the levels of fitted forms.
    pilot : task of the pilot in the Neal-Smith criterion, or None.
    units : units of the signals. An output whose unit is not that of a rate has no quantities of a
        pitch rate.
    """
    limits.refuse_unused(fits)
    if pilot is not None and kind is None:
        remedy = f"say what the outputs are with --bandwidth, {RATE} or {ATTITUDE}"
        raise DeclarationError("a pilot needs an attitude", where="--pilot", remedy=remedy)
    all_qualities = []
    # If a pitch rate is fitted too, a second-order response is that of the angle of attack.
    dutch_roll = fits is None or all(function.form.name != PITCH for function in fits.fit.functions)
    for place in product(range(len(names.outputs)), range(len(names.inputs))):
        output = names.outputs[place[0]]
        name = f"{output}/{names.inputs[place[1]]}"
        fitted = fits.of(*place) if fits is not None else None
        function = fitted[0] if fitted is not None else None
        if function is not None and no_rate(function.form, units.get(output, "")):
            function = None
        bandwidth = curve = None
        if kind is not None and responses.usable[place].any():
            target = target_of(responses, place, name)
            bandwidth = attitude_bandwidth(target, rate=kind == RATE)
            curve = attitude_curve(target, rate=kind == RATE)
        form: tuple[Quality, ...] = ()
        if function is not None:
            form = form_qualities(function, limits.airspeed, dutch_roll=dutch_roll)
        levels = form_levels(form, *limits.parts) if limits.flown is not None else ()
        if limits.flown is None and limits.airspeed is None:
            form = ()
        attitude_dropback = dropback(function) if function is not None else None
        if bandwidth is None and attitude_dropback is None and not form:
            continue
        all_qualities.append(
            Qualities(
                name,
                place,
                bandwidth,
                curve,
                attitude_dropback,
                form,
                levels,
                pitch_overshoot(function) if function is not None else None,
                neal_smith(curve, pilot) if curve is not None and pilot else None,
                limits.parts if limits.flown is not None else None,
                is_pitch(output, function.form.name if function is not None else ""),
            )
        )
    return tuple(all_qualities)


def quality_table(qualities: Qualities) -> Table | None:
    """Return the numbers of one response with their 95 % intervals; None if there are none."""
    if not qualities.numbers:
        return None
    rows = [
        (quality_name(name), quantity, unit) for name, (quantity, unit) in qualities.numbers.items()
    ]
    hertz = [
        formatted(quantity.value / (2.0 * math.pi), ".3g") if unit == "rad/s" else ""
        for _, quantity, unit in rows
    ]
    return table(
        f"Flying qualities of {qualities.name}, with 95 % intervals",
        (Column("quantity"), [name for name, _, _ in rows]),
        (Column("value", BY_ROW), [formatted(quantity.value, ".3g") for _, quantity, _ in rows]),
        (
            Column("+-", BY_ROW, beside=True),
            [formatted(NORMAL_HALF_WIDTH * quantity.std, ".2g") for _, quantity, _ in rows],
        ),
        (Column("frequency", "Hz"), hertz) if any(hertz) else None,
        units=["" if unit == "1" else unit for _, _, unit in rows],
    )


def quality_tables(qualities: Sequence[Qualities]) -> list[Table]:
    """Return a table of the flying qualities of each response that has some."""
    return [shown for shown in map(quality_table, qualities) if shown is not None]


def quality_lines(qualities: Sequence[Qualities]) -> list[str]:
    """Return the levels and undetermined flying qualities of all responses, a sentence each."""
    return [line for response in qualities for line in response.lines]


def levels_by_name(qualities: Sequence[Qualities]) -> dict[str, dict[str, tuple[int, int, int]]]:
    """Return level, and best and worst level within two sigmas, by response and by quantity or
    chart.
    """
    result = {}
    for response in qualities:
        levels = {
            level.quality.name: (level.level, level.best, level.worst) for level in response.levels
        }
        for chart in chart_levels(response):
            levels[chart.name] = (chart.level, chart.best, chart.worst)
        if levels:
            result[response.name] = levels
    return result


def levels_content(qualities: Qualities) -> list[dict[str, Any]]:
    """Return the levels of quantities and of charts for ``responses.json``."""
    return [
        *(
            _level_content(level.quality.name, level, level.criterion.source)
            | {"category": level.criterion.category}
            for level in qualities.levels
        ),
        *(_level_content(chart.name, chart, chart.source) for chart in chart_levels(qualities)),
    ]


def _level_content(name: str, level: QualityLevel | ChartLevel, source: str) -> dict[str, Any]:
    """Return a level for ``responses.json``."""
    return {
        "quantity": name,
        "level": level.level,
        "best": level.best,
        "worst": level.worst,
        "source": source,
    }
