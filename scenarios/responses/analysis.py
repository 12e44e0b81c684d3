"""Frequency responses from record files: options, estimates and cautions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ident.flying_qualities.pilot_in_loop import PilotDemand
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
from scenarios.files.measured.columns import identities, read_record_files, refuse_duplicates
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
HIGHEST_FREQUENCY_SHARE = 0.45  # highest frequency of a band over the sampling rate
# An input whose median coherence with the other inputs is above this depends on them.
PROPORTIONAL_COHERENCE = 0.9999
# The following limits lead to cautions.
LEAKED_FREQUENCY_SHARE = 0.1  # share of the frequencies with leaked power only
CORRELATED_COHERENCE = 0.5  # mean coherence of an input with the other inputs
# Share of the usable band in which direct and joint estimate differ by more than 95 % limits.
DISAGREEING_BAND_SHARE = 0.1
# Least variance of the difference of the two estimates over that of the joint estimate. Tested: 2
# false cautions in 87 records without feedback; feedback found in 60 of 60 records with noise of
# 1/3 and gain 1/2.
LEAST_VARIANCE_SHARE = 0.25


@dataclass(frozen=True)
class ResponseOptions:
    """Options of frequency-response estimates.

    Attributes
    ----------
    band : frequency band, Hz; None takes it from the longest window and the power of the inputs.
    windows : lengths of the windows, s. An empty tuple takes four: a quarter of the longest record,
        and each half of the one before.
    tapers : number of sine tapers of whole records; 0 for windows.
    least_coherence : least coherence of the usable band.
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
        for length in self.windows:
            if not (length > 0.0 and math.isfinite(length)):
                what = f"{length:g} s is no length"
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
    identities : names and hashes of the files.
    parts : names of the parts of records.
    durations : durations of the parts, s.
    names : names of the signals.
    units : signal -> unit.
    responses : the estimate from all parts; by the joint input-output method if there are
        references.
    direct : the direct estimate, if there are references.
    rate : rate of the samples, Hz.
    notes : sentences on the preparation.
    cautions : sentences on the result.
    simulated : whether all records are simulated.
    fits : fitted transfer functions.
    qualities : flying qualities of the responses.
    loop : stability margins.
    model : linear model fitted to the responses.
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

    def unit(self, output: str, input_name: str) -> str:
        """Return the unit of a response, as ``"deg/s per deg"``; empty if it has none."""
        output_unit, input_unit = (self.units.get(name, "") or "1" for name in (output, input_name))
        if output_unit == input_unit:
            return ""
        return output_unit if input_unit == "1" else f"{output_unit} per {input_unit}"

    def parameter_unit(self, output: str, input_name: str, name: str, unit: str) -> str:
        """Return the unit of parameter ``name`` of a fitted form, as ``"rad/s2 per rad"``.

        ``unit`` is the parameter's unit for a response without unit. The units of gains and of
        coefficients of the numerator are multiplied by that of the response.
        """
        if name != "gain" and re.fullmatch(r"b\d+", name) is None:
            return unit
        output_unit, input_unit = (
            self.units.get(signal, "") or "1" for signal in (output, input_name)
        )
        if output_unit == input_unit:
            output_unit = input_unit = "1"
        rate = re.fullmatch(r"(.+)/s(\d?)", output_unit)
        base, power = (rate[1], int(rate[2] or 1)) if rate is not None else (output_unit, 0)
        power += {"": 0, "1/s": 1}[unit] if unit in ("", "1/s") else int(unit.removeprefix("1/s"))
        numerator = base
        if power:
            numerator = f"{base}/s{power if power > 1 else ''}"
        if input_unit != "1":
            return f"{numerator} per {input_unit}"
        return "" if numerator == "1" else numerator

    def to_control(self) -> control.FrequencyResponseData:
        """Return the responses as an object of python-control, over all frequencies (rad/s).

        Points in the names of signals become underscores.
        """
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
    """Estimate frequency responses from all records of a request together.

    Parameters
    ----------
    request : the records and how they are read.
    names : names of the signals.
    options : options of the estimate.
    fit : transfer functions to fit.
    bandwidth : kind of the outputs, ``"rate"`` or ``"attitude"``, for bandwidth and phase delay.
    margins : sign of the feedback, ``"minus"`` or ``"plus"``, for stability margins.
    limits : aircraft class, category and airspeed for levels of fitted forms.
    pilot : task of the pilot in the Neal-Smith criterion.
    model : linear model to fit.

    Raises
    ------
    FlightidError : files or options cannot be used.
    """
    refuse_kind(bandwidth)
    refuse_loop(margins, names)
    refuse_duplicates(request.records)
    files = read_record_files(request.records)
    signal_names = (*names.inputs, *names.outputs, *names.references)
    # A channel map may define channels that flightid does not know.
    new_names = [name for name in signal_names if name.isidentifier() and name not in CHANNEL_UNITS]
    choices = column_choices(request, (*CHANNEL_UNITS, *new_names))
    read = read_signals(files, names, request.plan, choices)
    if margins is not None:
        # Both signals are inside one computer, so there is no hold between them.
        read = replace(read, hold=None)
    responses, direct, step, notes = estimated(read, options)
    _refuse_dependent_inputs(responses, names)
    fit = fit or FitOptions()
    if fit.fixed and not fit.forms and model.model is None:
        remedy = "add --fit FORM, or --model M"
        raise DeclarationError("no form is named", where="--fix", remedy=remedy)
    fits = fits_of(responses, names, fit)
    if model.model is not None and not fit.forms:
        model = replace(model, fixed=fit.values)
    hold_step = read.step if read.hold is Hold.PREVIOUS else None
    fitted = model_fit_of(responses, names, model, hold_step)
    estimate_part = partial(_responses_of_part, options, responses)
    loop = loop_margins_of(responses, names, margins, read, estimate_part)
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


def _responses_of_part(
    options: ResponseOptions, all_parts: FrequencyResponses, part: ReadSignals
) -> FrequencyResponses:
    """Return the responses of one part in the band of ``all_parts``, without frequencies that are
    too low for its duration.
    """
    low, high = float(all_parts.frequency[0]), float(all_parts.frequency[-1])
    _, lowest = _windows(part.durations, replace(options, band=(low, high)))
    return estimated(part, replace(options, band=(max(low, lowest), high)))[0]


def _windows(
    durations: Sequence[float], options: ResponseOptions
) -> tuple[tuple[float, ...], float]:
    """Return the lengths of windows, s, and the lowest frequency that they resolve, Hz; with tapers
    there are no windows.
    """
    if options.tapers:
        return (), 0.5 * (options.tapers + 1) / min(durations)
    lengths = options.windows
    if not lengths:
        lengths = window_lengths(durations, options.band[0] if options.band else None)
    windows = tuple(sorted(lengths, reverse=True))
    fitting = [length for length in windows if length <= max(durations)]
    return windows, lowest_frequency(fitting or windows)


def _refuse_dependent_inputs(responses: FrequencyResponses, names: Names) -> None:
    """Raise RecordError if an input is a linear combination of the other inputs."""
    if responses.joint or len(names.inputs) < 2:
        return
    for name, coherence in zip(names.inputs, responses.input_coherence, strict=True):
        if float(np.median(coherence)) > PROPORTIONAL_COHERENCE:
            what = f"{name} follows from the other inputs at every frequency"
            remedy = "leave one of them out; their responses cannot be separated"
            raise RecordError(what, where="--input", remedy=remedy)


def estimated(
    read: ReadSignals, options: ResponseOptions
) -> tuple[FrequencyResponses, FrequencyResponses | None, float, list[str]]:
    """Estimate the responses of signals.

    Returns
    -------
    responses : the estimate.
    direct : the direct estimate if ``responses`` is a joint estimate, else None.
    step : sampling interval of the estimate, s.
    notes : sentences on the method.
    """
    rate = 1.0 / read.step
    windows, lowest = _windows(read.durations, options)
    low, high = options.band or input_band(read.signals, lowest)
    notes = []
    if not options.band:
        source = "the tapers" if options.tapers else "the longest window"
        notes.append(
            f"band {low:.3g} to {high:.3g} Hz: from {source}, and up to 99 % of the inputs' power"
        )
    if high > HIGHEST_FREQUENCY_SHARE * rate:
        what = f"{high:g} Hz is above {HIGHEST_FREQUENCY_SHARE:g} of the rate of {rate:.4g} Hz"
        raise DeclarationError(what, where="--band", remedy="give a lower one")
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
        lengths = ", ".join(f"{length:.3g}" for length in windows)
        notes += [f"Hann windows of {lengths} s that overlap by three quarters, combined"]
    direct = None
    if result.joint:
        without_references = [replace(part, references=np.zeros((0, 0))) for part in signals]
        direct = estimate_responses(without_references, frequency, spectra)
        notes += ["joint input-output estimate by the references"]
    if read.hold is Hold.PREVIOUS:
        hold = _hold_response(2.0 * math.pi * frequency * read.step)
        result = _divided_by(result, hold)
        if direct is not None:
            direct = _divided_by(direct, hold)
        notes += ["the inputs are held between samples; the responses are corrected for this hold"]
    return result, direct, step, notes


def _hold_response(angle: np.ndarray) -> np.ndarray:
    """Return the frequency response of a zero-order hold at ``angle``, rad per sample."""
    return (1.0 - np.exp(-1j * angle)) / (1j * angle)


def _divided_by(responses: FrequencyResponses, factor: np.ndarray) -> FrequencyResponses:
    """Return responses divided by a complex factor at each frequency, ``(F,)``."""
    return replace(
        responses, response=responses.response / factor, std=responses.std / np.abs(factor)
    )


def cautions_of(
    responses: FrequencyResponses, direct: FrequencyResponses | None, names: Names
) -> tuple[str, ...]:
    """Return the cautions on an estimate, one sentence each."""
    cautions = []
    for row, output in enumerate(names.outputs):
        for column, input_name in enumerate(names.inputs):
            name = f"{output}/{input_name}"
            if not responses.usable[row, column].any():
                limit = f"{responses.spectra.least_coherence:g}"
                error = f"{100.0 * RANDOM_ERROR:g} %"
                cautions.append(
                    f"{name}: no frequency is usable, with a coherence of {limit}, a "
                    f"random error of {error} and power of the input on both sides"
                )
            elif direct is not None:
                cautions += _bias_of_direct(responses, direct, row, column, name)
    cautions += _leakage_cautions(responses, names)
    if not responses.joint and len(names.inputs) > 1:
        for name, coherence in zip(names.inputs, responses.input_coherence, strict=True):
            mean = float(coherence.mean())
            if mean > CORRELATED_COHERENCE:
                cautions.append(
                    f"input {name} has a mean coherence of {mean:.2f} with the other inputs: "
                    "their responses are hard to separate, see their errors"
                )
    return tuple(cautions)


def _leakage_cautions(responses: FrequencyResponses, names: Names) -> list[str]:
    """Return cautions on bands without input power, where the coherence is due to leakage."""
    cautions = []
    excitations = names.references if responses.joint else names.inputs
    for column, leaked in enumerate(responses.leaked):
        frequency = responses.frequency[leaked]
        if frequency.size > LEAKED_FREQUENCY_SHARE * leaked.size:
            usable = int(np.count_nonzero(leaked & responses.usable[:, column].any(axis=0)))
            remark = f"{usable} of them count as usable" if usable else "none of them is usable"
            cautions.append(
                f"{excitations[column]} has hardly any power between {frequency[0]:.3g} and "
                f"{frequency[-1]:.3g} Hz, where {frequency.size} of {leaked.size} frequencies "
                f"hold what leaks from others ({remark}); name the swept --band"
            )
    return cautions


def _bias_of_direct(
    responses: FrequencyResponses, direct: FrequencyResponses, row: int, column: int, name: str
) -> list[str]:
    """Return a sentence if the direct estimate contradicts the joint one; else an empty list."""
    band = responses.usable[row, column]
    difference = np.abs(direct.response - responses.response)[row, column, band]
    # Without feedback, the variance of the difference is that of the joint estimate minus that of
    # the direct one (Hausman, "Specification Tests in Econometrics", Econometrica 46(6), 1978).
    variance_share = 1.0 - (direct.std / responses.std)[row, column, band] ** 2
    variance_share = np.maximum(variance_share, LEAST_VARIANCE_SHARE)
    allowed = responses.radius()[row, column, band] * np.sqrt(variance_share)
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
    """Return row, column and name ``"OUTPUT/INPUT"`` of every response."""
    return [
        (row, column, f"{output}/{input_name}")
        for row, output in enumerate(estimates.names.outputs)
        for column, input_name in enumerate(estimates.names.inputs)
    ]
