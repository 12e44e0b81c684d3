"""Transfer functions fitted to estimated responses, and flying qualities from both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ident.flying_qualities.bandwidth import (
    PITCH_SOURCE,
    AttitudeCurve,
    Bandwidth,
    BandwidthQuantity,
    attitude_bandwidth,
    attitude_curve,
    dropback,
    pitch_bandwidth_level,
)
from ident.flying_qualities.levels import (
    CATEGORIES,
    CLASSES,
    Level,
    Quality,
    form_levels,
    form_qualities,
)
from ident.flying_qualities.pilot_in_loop import (
    PILOT_DELAY,
    NealSmith,
    PilotDemand,
    neal_smith,
    pitch_overshoot,
)
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.transfer_function import (
    BEST,
    FORMS,
    GOOD,
    PILOTED,
    FittedResponse,
    Target,
    TransferFit,
    fit_transfer_functions,
    form_of,
    unnoticeable,
)
from scenarios.responses.reading import Names
from sim.errors import DeclarationError, ModelError, RecordError

# ---- Transfer functions fitted to the estimated responses

NO_DELAY = 1e-9  # s, below which a delay is rounding
UNCERTAIN, INSENSITIVE = 0.2, 0.1  # of a value: Tischler and Remple's limits of both deviations


@dataclass(frozen=True)
class FitOptions:
    """Which transfer functions are fitted.

    Attributes
    ----------
    forms : ``FORM`` for every response or ``OUTPUT=FORM``; empty fits none.
    fixed : ``NAME=VALUE``. shared_poles : all denominators are the same.
    """

    forms: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    shared_poles: bool = False

    def __post_init__(self) -> None:
        if not self.forms and self.shared_poles:
            remedy = "add --fit FORM"
            raise DeclarationError("no form is named", where="--shared-poles", remedy=remedy)

    @property
    def values(self) -> dict[str, float]:
        """The fixed parameters."""
        out = {}
        for text in self.fixed:
            name, _, value = text.partition("=")
            try:
                out[name.strip()] = float(value)
            except ValueError:
                remedy = "write NAME=VALUE, as in delay=0"
                raise DeclarationError(
                    f"{text!r} fixes nothing", where="--fix", remedy=remedy
                ) from None
        return out


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Fitted response over estimated one along its usable band.

    Attributes
    ----------
    frequency : Hz. gain : dB, phase : deg, of the estimate over the model.
    gain_error, phase_error : half widths of their 95 % bands.
    """

    frequency: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    gain_error: np.ndarray
    phase_error: np.ndarray

    @property
    def piloted(self) -> np.ndarray:
        """Where the envelopes of unnoticeable dynamics are judged, bool."""
        omega = 2.0 * math.pi * self.frequency
        return np.asarray((omega >= PILOTED[0]) & (omega <= PILOTED[1]))

    @property
    def outside(self) -> np.ndarray:
        """Where the mismatch is beyond the envelopes by more than its 95 % band, bool."""
        limits = unnoticeable(2.0 * math.pi * self.frequency)
        gain = (self.gain - self.gain_error > limits.high_gain) | (
            self.gain + self.gain_error < limits.low_gain
        )
        phase = (self.phase - self.phase_error > limits.high_phase) | (
            self.phase + self.phase_error < limits.low_phase
        )
        return np.asarray((gain | phase) & self.piloted)


@dataclass(frozen=True, eq=False)
class Fits:
    """Transfer functions of some responses.

    Attributes
    ----------
    fit : all of them. places : row and column of the response of each. mismatches : of each.
    """

    fit: TransferFit
    places: tuple[tuple[int, int], ...]
    mismatches: tuple[Mismatch, ...]

    def of(self, row: int, column: int) -> tuple[FittedResponse, Mismatch] | None:
        """The function of a response and its mismatch; None where none was fitted."""
        if (row, column) not in self.places:
            return None
        at = self.places.index((row, column))
        return self.fit.functions[at], self.mismatches[at]


def fits_of(found: FrequencyResponses, names: Names, options: FitOptions) -> Fits | None:
    """Fit the forms to the responses in their usable bands; None where no form is named.

    Raises DeclarationError, RecordError or ModelError in one line.
    """
    if not options.forms:
        return None
    by_output = _by_output(options.forms, names.outputs)
    places, targets, forms = [], [], []
    for row, output in enumerate(names.outputs):
        for column, one in enumerate(names.inputs):
            if output not in by_output:
                continue
            usable = found.usable[row, column]
            if not usable.any():
                what = f"no usable band of {output}/{one} to fit"
                raise RecordError(what, where="--fit", remedy="lower --coherence, or leave it out")
            targets.append(target_of(found, (row, column), f"{output}/{one}"))
            places.append((row, column))
            forms.append(form_of(by_output[output]))
    try:
        fit = fit_transfer_functions(
            targets, forms, options.values, shared_poles=options.shared_poles
        )
    except ModelError as error:
        option = {"fix": "--fix", "shared poles": "--shared-poles"}.get(error.where, "--fit")
        raise DeclarationError(error.what, where=option, remedy=error.remedy) from None
    each = tuple(
        _mismatch(found, place, function)
        for place, function in zip(places, fit.functions, strict=True)
    )
    return Fits(fit, tuple(places), each)


def target_of(found: FrequencyResponses, place: tuple[int, int], name: str) -> Target:
    """The usable band of a response, as it is fitted."""
    usable = found.usable[place]
    likeness = found.coherence[place[0]] if found.joint else found.partial_coherence[place]
    return Target(
        name,
        2.0 * math.pi * found.frequency[usable],
        found.response[place][usable],
        likeness[usable],
        found.std[place][usable],
        found.lengths[place[0]][usable],
    )


def _by_output(forms: Sequence[str], outputs: Sequence[str]) -> Mapping[str, str]:
    out: dict[str, str] = {}
    for text in forms:
        output, equals, form = text.rpartition("=")
        if equals and output not in outputs:
            remedy = f"the outputs are {', '.join(outputs)}"
            raise DeclarationError(f"there is no output {output!r}", where="--fit", remedy=remedy)
        try:
            form_of(form)
        except ModelError as error:
            raise DeclarationError(error.what, where="--fit", remedy=error.remedy) from None
        for name in (output,) if equals else outputs:
            if name in out:
                what = f"two forms for {name}"
                raise DeclarationError(what, where="--fit", remedy="name one for each output")
            out[name] = form
    return out


def _mismatch(
    found: FrequencyResponses, place: tuple[int, int], function: FittedResponse
) -> Mismatch:
    usable = found.usable[place]
    frequency = found.frequency[usable]
    response = found.response[place][usable]
    ratio = response / function.response(2.0 * math.pi * frequency)
    share = np.minimum((found.half_width()[place] / np.abs(found.response[place]))[usable], 0.999)
    turn = found.phase_half_width()[place][usable]
    return Mismatch(
        frequency,
        20.0 * np.log10(np.abs(ratio)),
        np.degrees(np.angle(ratio)),
        -20.0 * np.log10(1.0 - share),
        np.degrees(turn),
    )


def cost_sentence(function: FittedResponse) -> str:
    """``"cost 12.3: hardly to be told from the data (below 50)"``."""
    cost = function.cost
    if cost <= BEST:
        said = f"close to the data (below {BEST:g})"
    elif cost <= GOOD:
        said = f"acceptable (below {GOOD:g})"
    else:
        said = f"the form does not describe the response (above {GOOD:g})"
    return f"cost {cost:.3g}: {said}"


def envelope_sentence(function: FittedResponse, mismatch: Mismatch) -> str:
    """Whether the mismatch of a low-order form would be noticed; empty for plain orders."""
    if function.form.name not in FORMS or not mismatch.piloted.any():
        return ""
    outside = mismatch.outside
    rad = 2.0 * math.pi * mismatch.frequency
    judged = rad[mismatch.piloted]
    band = f"{judged[0]:.3g} to {judged[-1]:.3g} rad/s"
    if not outside.any():
        return f"mismatch within the envelopes of unnoticeable added dynamics, {band}"
    beyond = rad[outside]
    return (
        f"mismatch beyond the envelopes of unnoticeable added dynamics at {outside.sum()} of "
        f"{judged.size} frequencies from {band}, first at {beyond[0]:.3g} rad/s"
    )


def transfer_text(function: FittedResponse) -> str:
    """``"(5.98 s + 7.3) / (s^2 + 3.2 s + 16.1) exp(-0.0101 s)"``."""
    top, bottom = _polynomial(function.numerator), _polynomial(function.denominator)
    late = function.values["delay"]
    return f"({top}) / ({bottom})" + (f" exp(-{late:.4g} s)" if late > NO_DELAY else "")


def _polynomial(coefficients: np.ndarray) -> str:
    order = len(coefficients) - 1
    parts: list[str] = []
    for n, value in enumerate(coefficients.tolist()):
        power = order - n
        letter = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        number = f"{abs(value):.4g}"
        body = letter if letter and number == "1" else f"{number} {letter}".strip()
        sign = "-" if value < 0 else "+"
        parts.append((f"{sign} " if parts else ("-" if value < 0 else "")) + body)
    return " ".join(parts)


def fit_cautions(fits: Fits | None) -> tuple[str, ...]:
    """What a user should know of the fits, one sentence each."""
    if fits is None:
        return ()
    out = [] if fits.fit.converged else ["the search for the transfer functions did not end"]
    for function in fits.fit.functions:
        if function.cost > GOOD:
            out.append(f"{function.name}, {function.form.name}: {cost_sentence(function)}")
        uncertain = [name for name in function.std if _hardly_determined(function, name)]
        if _may_be_none(function):
            late, std = function.values["delay"], function.std["delay"]
            shown = late if late > NO_DELAY else 0.0
            out.append(
                f"{function.name}: the delay is {shown:.2g} +- {std:.2g} s, which may be none; "
                "--fix delay=0 leaves it out"
            )
            uncertain = [name for name in uncertain if name != "delay"]
        if uncertain:
            limits = f"deviation above {100 * UNCERTAIN:.0f} % or {100 * INSENSITIVE:.0f} % alone"
            said = f"{function.name}: {', '.join(uncertain)} hardly determined ({limits})"
            out.append(f"{said}; fix one of them with --fix, or take a lower order")
    return tuple(out)


def _hardly_determined(function: FittedResponse, name: str) -> bool:
    """Whether one of the two deviations of a free parameter exceeds its limit."""
    size = abs(function.values[name])
    return (
        function.std[name] > UNCERTAIN * size or function.insensitivity[name] > INSENSITIVE * size
    )


def _may_be_none(function: FittedResponse) -> bool:
    """Whether a free delay differs from zero by less than two standard deviations."""
    return "delay" in function.std and function.values["delay"] < 2.0 * function.std["delay"]


# ---- Flying qualities from estimated responses

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
            raise DeclarationError(
                what, where="--levels", remedy=f"write CLASS-CATEGORY of {known}, as in IV-A"
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
        """Raise DeclarationError where nothing is fitted that the options are for."""
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
    """What is asked of a pilot; None without a bandwidth. Raises DeclarationError for numbers that
    are none, or for a delay without a bandwidth."""
    if bandwidth is None:
        if delay is not None:
            remedy = "add --pilot RAD/S, the closed-loop bandwidth"
            raise DeclarationError("there is no pilot", where="--pilot-delay", remedy=remedy)
        return None
    late = PILOT_DELAY if delay is None else delay
    for option, value, fine in (
        ("--pilot", bandwidth, bandwidth > 0.0),
        ("--pilot-delay", late, late >= 0.0),
    ):
        if not (fine and math.isfinite(value)):
            raise DeclarationError(f"{value:g}", where=option, remedy="give a positive number")
    return PilotDemand(bandwidth, late)


@dataclass(frozen=True, eq=False)
class Qualities:
    """Flying qualities of one response.

    Attributes
    ----------
    name : of the response. place : its row and column.
    bandwidth, curve : where a kind of output is named. dropback : where ``pitch`` is fitted, s.
    form : quantities of a fitted form. levels : of these, where limits are asked for.
    overshoot : of the pitch rate after a step, largest over steady. pilot : of Neal and Smith, or
        why there is none. flown : class and category of the levels.
    """

    name: str
    place: tuple[int, int]
    bandwidth: Bandwidth | None
    curve: AttitudeCurve | None
    dropback: BandwidthQuantity | None
    form: tuple[Quality, ...] = ()
    levels: tuple[Level, ...] = ()
    overshoot: BandwidthQuantity | None = None
    pilot: NealSmith | str | None = None
    flown: tuple[str, str] | None = None

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
        found["pitch_rate_overshoot"] = (self.overshoot, "1")
        if isinstance(self.pilot, NealSmith):
            found["pilot_resonance"] = (self.pilot.resonance, "dB")
            found["pilot_compensation"] = (self.pilot.compensation, "deg")
        found |= {
            each.name: (BandwidthQuantity(each.value, each.std), each.unit) for each in self.form
        }
        return {name: (each, unit) for name, (each, unit) in found.items() if each is not None}

    @property
    def lines(self) -> list[str]:
        """A sentence for each quantity, and for what is not known."""
        words = {
            "neutral_frequency": "phase of -180 deg",
            "dropback": "dropback over steady rate",
            "pitch_rate_overshoot": "largest over steady pitch rate",
            "pilot_resonance": "resonance of Neal and Smith's closed loop",
            "pilot_compensation": "phase of Neal and Smith's pilot",
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
            between = (
                f"; {level.best} to {level.worst} within two sigmas" if level.uncertain else ""
            )
            out.append(f"{self.name}: {said}: {reached}{between} ({level.criterion.source})")
        out += [f"{self.name}: {line}" for line in _chart_lines(self)]
        notes = self.bandwidth.notes if self.bandwidth is not None else ()
        return out + [f"{self.name}: {note}" for note in notes]


def _chart_lines(one: Qualities) -> list[str]:
    """Levels of criteria with two quantities, and what is said of the pilot."""
    out = []
    band = one.bandwidth
    if one.flown is not None and one.flown[1] == "A" and band is not None:
        both = (band.bandwidth, band.delay)
        if both[0] is not None and both[1] is not None:
            level = pitch_bandwidth_level(both[0].value, both[1].value)
            ends = [
                pitch_bandwidth_level(
                    both[0].value - sign * 2.0 * both[0].std,
                    max(both[1].value + sign * 2.0 * both[1].std, 0.0),
                )
                for sign in (-1.0, 1.0)
            ]
            out.append(
                f"bandwidth and phase delay, if this is pitch: {level_text(level, *ends)}"
                f" ({PITCH_SOURCE})"
            )
    if isinstance(one.pilot, str):
        out.append(one.pilot)
    elif one.pilot is not None:
        found = one.pilot
        demand = f"{found.demand.bandwidth:g} rad/s, delay {found.demand.delay:g} s"
        out.append(
            f"resonance at {demand}: {level_text(found.level, found.best, found.worst)}"
            " (MIL-STD-1797A, 4.2.1.2, closed-loop criterion)"
        )
        out += found.notes
    return out


def level_text(level: int, best: int, worst: int) -> str:
    """``"level 1; 1 to 2 within two sigmas"``."""
    return f"level {level}" + (f"; {best} to {worst} within two sigmas" if best != worst else "")


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
    pilot: PilotDemand | None = None,
) -> tuple[Qualities, ...]:
    """Flying qualities of every response with a usable band; ``kind`` : of the outputs, rate or
    attitude; None leaves bandwidth and phase delay out. ``limits`` : of the levels of fitted
    forms. ``pilot`` : what is asked of Neal and Smith's."""
    limits.refuse_unused(fits)
    if pilot is not None and kind is None:
        remedy = f"say what the outputs are with --bandwidth, {RATE} or {ATTITUDE}"
        raise DeclarationError("a pilot needs an attitude", where="--pilot", remedy=remedy)
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
                flown = limits.parts if limits.flown is not None else None
                place = (row, column)
                out.append(
                    Qualities(
                        name, place, bandwidth, curve, fall, form, levels, over, closed, flown
                    )
                )
    return tuple(out)
