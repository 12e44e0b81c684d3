"""Frequency responses from record files: options, estimates and cautions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ident.flying_qualities.attitude_criteria import PilotDemand
from ident.frequency_response import (
    LEAST_COHERENCE,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)
from ident.frequency_response.estimate import (
    RANDOM_ERROR,
    decimated,
    frequencies,
    input_band,
    lowest_frequency,
    window_lengths,
)
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.files.measured.columns import identities, read_record_files, refuse_twice
from scenarios.files.sources import InputFile
from scenarios.preparation.plan import Request, column_choices
from scenarios.responses.fitting import (
    FitOptions,
    Fits,
    FittedResponseModel,
    ModelOptions,
    fit_cautions,
    fits_of,
    model_fit_of,
)
from scenarios.responses.loops import LoopMargins, loop_margins_of, refuse_loop
from scenarios.responses.qualities import (
    NO_LEVELS,
    LevelOptions,
    Qualities,
    form_cautions,
    qualities_of,
    refuse_kind,
)
from scenarios.responses.reading import Names, ReadSignals, read_signals
from sim.errors import DeclarationError, RecordError
from sim.record import Hold

if TYPE_CHECKING:
    import control

NO_MODEL = ModelOptions()
# median coherence with other inputs above which an input is not usable
PROPORTIONAL_COHERENCE = 0.9999
LEAKED_FREQUENCY_SHARE = 0.1  # share of the frequencies above which there is a caution
# mean coherence with other inputs above which there is a caution
CORRELATED_COHERENCE = 0.5
# share of the usable band in which direct and joint estimate differ beyond 95 %
DISAGREEING_BAND_SHARE = 0.1
# Least variance of the difference, share of the joint estimate's variance. Measured: 2 false
# cautions in 87 records without feedback; with noise of 1/3 and gain 1/2, found in 60 of 60.
LEAST_APART = 0.25


@dataclass(frozen=True)
class ResponseOptions:
    """Options of frequency-response estimates.

    Attributes
    ----------
    band : Hz; None takes it from the longest window and the power of the inputs.
    windows : s, lengths; empty takes four, halved from a quarter of the longest record.
    tapers : sine tapers of whole records instead of windows; 0 for windows.
    least_coherence : of the usable band.
    """

    band: tuple[float, float] | None = None
    windows: tuple[float, ...] = ()
    tapers: int = 0
    least_coherence: float = LEAST_COHERENCE

    def __post_init__(self) -> None:
        if self.band is not None:
            low, high = self.band
            if not (0.0 < low < high and math.isfinite(high)):
                what = f"{low:g} to {high:g} Hz is no band"
                raise DeclarationError(what, where="--band", remedy="give LOW HIGH in Hz, above 0")
        for each in self.windows:
            if not (each > 0.0 and math.isfinite(each)):
                what = f"{each:g} s is no length"
                raise DeclarationError(what, where="--window", remedy="give lengths above zero")
        if self.tapers and self.windows:
            what = "windows and tapers are two ways"
            raise DeclarationError(what, where="--window, --tapers", remedy="leave one of them out")
        if self.tapers == 1 or self.tapers < 0:
            what = f"{self.tapers} tapers"
            raise DeclarationError(what, where="--tapers", remedy="give 3 or more")
        if not 0.0 < self.least_coherence < 1.0:
            what = f"{self.least_coherence:g} is no coherence"
            raise DeclarationError(
                what, where="--coherence", remedy="give a number between 0 and 1"
            )


@dataclass(frozen=True, eq=False, repr=False)
class ResponseEstimates:
    """Frequency responses of records.

    Attributes
    ----------
    identities : the files.
    parts : names of the records and parts that were pooled.
    names : signals.
    units : by signal.
    responses : the estimate; by the joint input-output method if references are given.
    direct : in this case the direct estimate.
    rate : Hz, of the samples.
    notes : on the preparation.
    cautions : on the result.
    simulated : all records are simulated.
    fits : transfer functions.
    model : linear model fitted to the responses.
    qualities : flying qualities of the responses.
    loop : stability margins.
    """

    identities: tuple[InputFile, ...]
    parts: tuple[str, ...]
    durations: tuple[float, ...]
    names: Names
    units: Mapping[str, str]
    responses: FrequencyResponses
    direct: FrequencyResponses | None
    rate: float
    notes: tuple[str, ...]
    cautions: tuple[str, ...]
    simulated: bool
    fits: Fits | None = None
    qualities: tuple[Qualities, ...] = ()
    loop: LoopMargins | None = None
    model: FittedResponseModel | None = None

    def unit(self, output: str, one: str) -> str:
        """Unit of a response, ``"deg/s per deg"``; empty if neither signal has one."""
        over, under = (self.units.get(name, "") or "1" for name in (output, one))
        if over == under:
            return ""
        return over if under == "1" else f"{over} per {under}"

    def parameter_unit(self, output: str, one: str, name: str, unit: str) -> str:
        """Unit of a parameter of a fitted form: that of the form, and of gains and coefficients of
        the numerator times that of the response, ``"rad/s2 per rad"``.
        """
        if name != "gain" and re.fullmatch(r"b\d+", name) is None:
            return unit
        over, under = (self.units.get(each, "") or "1" for each in (output, one))
        if over == under:
            over = under = "1"
        rate = re.fullmatch(r"(.+)/s(\d?)", over)
        base, power = (rate[1], int(rate[2] or 1)) if rate is not None else (over, 0)
        power += {"": 0, "1/s": 1}[unit] if unit in ("", "1/s") else int(unit.removeprefix("1/s"))
        whole = f"{base}/s{power if power > 1 else ''}" if power else base
        if under != "1":
            return f"{whole} per {under}"
        return "" if whole == "1" else whole

    def to_control(self) -> control.FrequencyResponseData:
        """The responses as python-control's, over all frequencies, rad/s; points in names become
        underscores."""
        import control

        names = {
            "inputs": [name.replace(".", "_") for name in self.names.inputs],
            "outputs": [name.replace(".", "_") for name in self.names.outputs],
        }
        omega = 2.0 * math.pi * self.responses.frequency
        return control.FrequencyResponseData(self.responses.response, omega, **names)

    def __repr__(self) -> str:
        pairs = len(self.names.inputs) * len(self.names.outputs)
        return f"<Responses of {', '.join(self.parts[:3])}: {pairs}>"


def responses_of(
    request: Request,
    names: Names,
    options: ResponseOptions,
    fit: FitOptions | None = None,
    bandwidth: str | None = None,
    margins: str | None = None,
    limits: LevelOptions = NO_LEVELS,
    pilot: PilotDemand | None = None,
    model: ModelOptions = NO_MODEL,
) -> ResponseEstimates:
    """Estimate the responses of the records of a request, pooled.

    ``fit``: transfer functions. ``bandwidth``: kind of outputs, ``"rate"`` or ``"attitude"``, for
    bandwidth and phase delay. ``margins``: sign of the feedback, ``"minus"`` or ``"plus"``, for
    stability margins. ``limits``: of levels of fitted forms. ``pilot``: of the Neal-Smith
    criterion. ``model``: a linear model to fit.

    Raises
    ------
    FlightidError : anything in files or options that keeps them from being used.
    """
    refuse_kind(bandwidth)
    refuse_loop(margins, names)
    refuse_twice(request.records)
    files = read_record_files(request.records)
    signal_names = (*names.inputs, *names.outputs, *names.references)
    words = [name for name in signal_names if name.isidentifier() and name not in CHANNEL_UNITS]
    chosen = column_choices(request, (*CHANNEL_UNITS, *words))
    read = read_signals(files, names, request.plan, chosen)
    if margins is not None:
        # Both signals are inside one computer, so there is no hold between them.
        read = replace(read, hold=None)
    responses, direct, step, notes = estimated(read, options)
    _refuse_proportional(responses, names)
    fit = fit or FitOptions()
    if fit.fixed and not fit.forms and model.model is None:
        remedy = "add --fit FORM, or --model M"
        raise DeclarationError("no form is named", where="--fix", remedy=remedy)
    fits = fits_of(responses, names, fit)
    if model.model is not None and not fit.forms:
        model = replace(model, fixed=fit.values)
    hold_step = read.step if read.hold is Hold.PREVIOUS else None
    fitted = model_fit_of(responses, names, model, hold_step)
    loop = loop_margins_of(responses, names, margins, read, partial(_of_a_part, options, responses))
    return ResponseEstimates(
        identities(files),
        read.names,
        read.durations,
        names,
        read.units,
        responses,
        direct,
        1.0 / step,
        (*read.notes, *notes),
        (
            *read.doubts,
            *cautions_of(responses, direct, names),
            *fit_cautions(fits),
            *form_cautions(fits, names, read.units),
            *(fitted.cautions if fitted else ()),
            *(loop.cautions if loop else ()),
        ),
        all(file.sidecar.simulated for file in files),
        fits,
        qualities_of(responses, names, bandwidth, fits, limits, pilot, read.units),
        loop,
        fitted,
    )


def _of_a_part(
    options: ResponseOptions, whole: FrequencyResponses, part: ReadSignals
) -> FrequencyResponses:
    """Return the responses of one part, in the band of all parts together as far as the part
    resolves it.
    """
    low, high = float(whole.frequency[0]), float(whole.frequency[-1])
    _, lowest = _windows(part.durations, replace(options, band=(low, high)))
    return estimated(part, replace(options, band=(max(low, lowest), high)))[0]


def _windows(
    durations: Sequence[float], options: ResponseOptions
) -> tuple[tuple[float, ...], float]:
    """Lengths of windows, s, none with tapers, and the lowest frequency that they resolve, Hz."""
    if options.tapers:
        return (), 0.5 * (options.tapers + 1) / min(durations)
    windows = options.windows or window_lengths(
        durations, options.band[0] if options.band else None
    )
    windows = tuple(sorted(windows, reverse=True))
    return windows, lowest_frequency(
        [each for each in windows if each <= max(durations)] or windows
    )


def _refuse_proportional(estimated_responses: FrequencyResponses, names: Names) -> None:
    """Raise RecordError if an input is a combination of the other inputs."""
    if estimated_responses.joint or len(names.inputs) < 2:
        return
    for one, coherence in zip(names.inputs, estimated_responses.input_coherence, strict=True):
        if float(np.median(coherence)) > PROPORTIONAL_COHERENCE:
            what = f"{one} follows from the other inputs at every frequency"
            remedy = "leave one of them out; their responses cannot be separated"
            raise RecordError(what, where="--input", remedy=remedy)


def estimated(
    read: ReadSignals, options: ResponseOptions
) -> tuple[FrequencyResponses, FrequencyResponses | None, float, list[str]]:
    """Return the estimate, the direct one where it is a joint one, the step used, s, and notes."""
    rate = 1.0 / read.step
    windows, lowest = _windows(read.durations, options)
    low, high = options.band or input_band(read.signals, lowest)
    notes = []
    if not options.band:
        begins = "the tapers" if options.tapers else "the longest window"
        band = f"band {low:.3g} to {high:.3g} Hz"
        notes.append(f"{band}: from {begins}, and up to 99 % of the inputs' power")
    if high > 0.45 * rate:
        what, remedy = f"{high:g} Hz is above 0.45 of the rate of {rate:.4g} Hz", "give a lower one"
        raise DeclarationError(what, where="--band", remedy=remedy)
    if low < lowest * (1.0 - 1e-9):
        what = f"{low:g} Hz is below {lowest:.3g} Hz, the lowest that the record resolves"
        raise DeclarationError(what, where="--band", remedy="give a higher one, or a longer record")
    signals, factor = decimated(read.signals, high)
    step = factor * read.step
    notes += ["linear trends are removed from all signals of each part"]
    if factor > 1:
        notes += [f"decimated from {rate:.4g} to {1.0 / step:.4g} Hz after one zero-phase filter"]
    spectra = Spectra(windows, options.tapers, least_coherence=options.least_coherence)
    frequency = frequencies(low, high)
    result = estimate_responses(signals, frequency, spectra)
    if options.tapers:
        notes += [f"{options.tapers} sine tapers of each whole part"]
    else:
        lengths = ", ".join(f"{each:.4g}" for each in windows)
        notes += [f"Hann windows of {lengths} s that overlap by three quarters, combined"]
    direct = None
    if result.joint:
        open_ = [replace(each, references=np.zeros((0, 0))) for each in signals]
        direct = estimate_responses(open_, frequency, spectra)
        notes += ["joint input-output estimate by the references"]
    if read.hold is Hold.PREVIOUS:
        between = _hold_response(2.0 * math.pi * frequency * read.step)
        result, direct = (
            _without(result, between),
            None if direct is None else _without(direct, between),
        )
        notes += ["the inputs are held between samples; the responses are corrected for this hold"]
    return result, direct, step, notes


def _hold_response(angle: np.ndarray) -> np.ndarray:
    """Return the frequency response of a zero-order hold at ``angle``, rad per sample."""
    return (1.0 - np.exp(-1j * angle)) / (1j * angle)


def _without(responses: FrequencyResponses, between: np.ndarray) -> FrequencyResponses:
    return replace(
        responses, response=responses.response / between, std=responses.std / np.abs(between)
    )


def cautions_of(
    estimated_responses: FrequencyResponses, direct: FrequencyResponses | None, names: Names
) -> tuple[str, ...]:
    """Return the cautions on an estimate, one sentence each."""
    out = []
    for row, output in enumerate(names.outputs):
        for column, one in enumerate(names.inputs):
            if not estimated_responses.usable[row, column].any():
                limit = f"{estimated_responses.spectra.least_coherence:g}"
                error = f"{100.0 * RANDOM_ERROR:g} %"
                out.append(
                    f"{output}/{one}: no frequency is usable, with a coherence of {limit}, a "
                    f"random error of {error} and power of the input on both sides"
                )
            elif direct is not None:
                out += _bias_of_direct(estimated_responses, direct, row, column, f"{output}/{one}")
    out += _leaks(estimated_responses, names)
    if not estimated_responses.joint and len(names.inputs) > 1:
        for column, one in enumerate(names.inputs):
            mean = float(estimated_responses.input_coherence[column].mean())
            if mean > CORRELATED_COHERENCE:
                sentence = f"input {one} has a mean coherence of {mean:.2f} with the other inputs"
                out.append(f"{sentence}: their responses are hard to separate, see their errors")
    return tuple(out)


def _leaks(responses: FrequencyResponses, names: Names) -> list[str]:
    """Return cautions on bands without input power, where the coherence is due to leakage."""
    out = []
    excitations = names.references if responses.joint else names.inputs
    for column, leaked in enumerate(responses.leaked):
        places = responses.frequency[leaked]
        if places.size > LEAKED_FREQUENCY_SHARE * leaked.size:
            usable = int(np.count_nonzero(leaked & responses.usable[:, column].any(axis=0)))
            sentence = f"{excitations[column]} has hardly any power between {places[0]:.3g} and"
            remark = f"{usable} of them count as usable" if usable else "none of them is usable"
            out.append(
                f"{sentence} {places[-1]:.3g} Hz, where {places.size} of {leaked.size} frequencies "
                f"hold what leaks from others ({remark}); name the swept --band"
            )
    return out


def _bias_of_direct(
    responses: FrequencyResponses, direct: FrequencyResponses, row: int, column: int, name: str
) -> list[str]:
    """Return a sentence where the direct estimate contradicts the joint one."""
    band = responses.usable[row, column]
    difference = np.abs(direct.response - responses.response)[row, column, band]
    # Without feedback the difference has the joint one's variance less the direct one's (Hausman,
    # "Specification Tests in Econometrics", Econometrica 46(6), 1978); LEAST_APART floors it.
    left = 1.0 - (direct.std / responses.std)[row, column, band] ** 2
    allowed = responses.radius()[row, column, band] * np.sqrt(np.maximum(left, LEAST_APART))
    share = float(np.mean(difference > allowed))
    if share <= DISAGREEING_BAND_SHARE:
        return []
    ratio = direct.response[row, column, band] / responses.response[row, column, band]
    decibel = float(np.max(np.abs(20.0 * np.log10(np.abs(ratio)))))
    return [
        f"{name}: the direct estimate is biased by feedback: it differs from the joint one by up "
        f"to {decibel:.2g} dB, more than chance does at {100.0 * share:.0f} % of the usable band"
    ]


def pairs(estimates: ResponseEstimates) -> list[tuple[int, int, str]]:
    """Row, column and name ``"q/elevator"`` of every response, outputs first."""
    return [
        (row, column, f"{output}/{one}")
        for row, output in enumerate(estimates.names.outputs)
        for column, one in enumerate(estimates.names.inputs)
    ]
