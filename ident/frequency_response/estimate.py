"""Frequency responses of records, with several inputs and with feedback; default settings.

Estimates with windows of several lengths are combined as in Tischler and Remple, "Aircraft and
Rotorcraft System Identification", 2nd edition, AIAA 2012, chapter 10. Conditioned responses and
partial coherence are those of chapter 9. Random errors follow Bendat and Piersol, "Random Data",
4th edition, Wiley 2010, chapters 6, 7 and 9.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.frequency_response.segments import (
    LEAST_PERIODS_IN_LONGEST_WINDOW,
    Segments,
    coherences,
    effective_averages,
    hann_segments,
    regress,
    sine_segments,
    spectral_matrix,
)
from sim.errors import RecordError

# ---- Frequency responses of records

_CONFIDENCE = 0.95  # probability that a band or circle contains the response
LEAST_COHERENCE = 0.6  # smallest coherence of a usable response (Tischler and Remple)
RANDOM_ERROR = 0.2  # largest random error of a usable magnitude (Tischler and Remple)
# largest mean distance of input power from a usable frequency, times the window length
LARGEST_POWER_OFFSET = 0.6
WINDOW_DERIVATIVES = 2  # highest derivative of the window in the regression
MAIN_LOBE_HALF_WIDTH = 2.0  # half-width of the main lobe of a Hann window, times its length
# fewest periods in a window that is used alone, in a regression with derivatives
FEWEST_PERIODS_OF_SINGLE_WINDOW = 3.0
_LEAST_NOISE_DEGREES = 4.0  # fewest real degrees of freedom of the noise estimate
_RANDOM_ERROR_POWER = 4.0  # a window has the weight error^-4 (Tischler and Remple)
_MOST_REGRESSORS_AT_ONCE = 400_000  # regressors that are processed together
_SMOOTHED_NEIGHBOURS = 5  # frequencies over which weights and coherence are smoothed


@dataclass(frozen=True, eq=False)
class EvenSignals:
    """Evenly sampled signals of one record.

    Attributes
    ----------
    step : sampling interval, s.
    inputs, outputs : ``(q, N)`` and ``(m, N)``.
    references : ``(q, N)`` excitations without noise, or ``(0, N)`` without references.
    """

    step: float
    inputs: np.ndarray
    outputs: np.ndarray
    references: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def stacked(self) -> np.ndarray:
        """All signals, detrended: outputs, inputs, then references."""
        rows = [self.outputs, self.inputs]
        rows += [self.references] if len(self.references) else []
        return detrended(np.concatenate(rows))


@dataclass(frozen=True)
class Spectra:
    """Settings of spectral estimates.

    Attributes
    ----------
    windows : lengths of the Hann windows, s, the longest first.
    tapers : number of sine tapers of each whole record in place of windows; 0 takes windows.
    derivatives : number of derivatives of the window in the regression, which reduce the bias by
        the window.
    least_coherence : smallest coherence of the usable band.
    """

    windows: tuple[float, ...] = ()
    tapers: int = 0
    derivatives: int = WINDOW_DERIVATIVES
    least_coherence: float = LEAST_COHERENCE


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Responses of m outputs to q inputs at F frequencies.

    Attributes
    ----------
    frequency : ``(F,)``, Hz.
    response : complex ``(m, q, F)``, to each input with the other inputs constant.
    std : ``(m, q, F)`` standard deviation of the real and of the imaginary part; if joint, at least
        the magnitude where the references do not move an input.
    degrees : ``(m, F)`` real degrees of freedom of the noise estimate in ``std``.
    coherence : ``(m, F)`` multiple coherence with all inputs; if joint, with the references.
    partial_coherence : ``(m, q, F)``; with one input it is the ordinary coherence.
    input_coherence : ``(q, F)`` of each input with the others; if joint, with the references.
    usable : bool ``(m, q, F)``, the usable band.
    averages : ``(m, F)`` number of independent averages.
    lengths : ``(m, F)`` weighted geometric mean of the window lengths, s. Errors of frequencies
        closer than about one over it are correlated.
    spectra : settings of the estimate.
    joint : whether it is a joint input-output estimate.
    leaked : bool ``(q, F)``, True where the transform of an input, or of its reference if joint, is
        due to power outside the main lobe. Empty with sine tapers.
    """

    frequency: np.ndarray
    response: np.ndarray
    std: np.ndarray
    degrees: np.ndarray
    coherence: np.ndarray
    partial_coherence: np.ndarray
    input_coherence: np.ndarray
    usable: np.ndarray
    averages: np.ndarray
    lengths: np.ndarray
    spectra: Spectra
    joint: bool = False
    leaked: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))

    @property
    def random_error(self) -> np.ndarray:
        """Normalised random error ``(m, q, F)``: standard deviation over magnitude."""
        return np.asarray(self.std / np.maximum(np.abs(self.response), np.finfo(float).tiny))

    def half_width(self, level: float = 0.95) -> np.ndarray:
        """Return the half-width ``(m, q, F)`` of the band of magnitude, by Student's quantile."""
        from scipy.stats import t

        return np.asarray(t.ppf(0.5 * (1.0 + level), self.degrees)[:, None, :] * self.std)

    def radius(self) -> np.ndarray:
        """Return the radius ``(m, q, F)`` of the circle in the complex plane that contains the
        response with probability 0.95, by the F distribution (Bendat and Piersol, section 6.2.4).
        """
        from scipy.stats import f

        quantile = f.ppf(_CONFIDENCE, 2.0, self.degrees)
        return np.asarray(np.sqrt(2.0 * quantile)[:, None, :] * self.std)

    def phase_half_width(self) -> np.ndarray:
        """Return the half-width ``(m, q, F)`` of the 95 % band of the phase, rad; at most pi."""
        size = np.maximum(np.abs(self.response), np.finfo(float).tiny)
        share = self.half_width(_CONFIDENCE) / size
        return np.where(share < 1.0, np.arcsin(np.minimum(share, 1.0)), math.pi)

    def phase(self) -> np.ndarray:
        """Return the phases ``(m, q, F)``, rad, unwrapped both ways from each usable band."""
        phases = np.empty(self.response.shape)
        for place in np.ndindex(*self.response.shape[:2]):
            phases[place] = _unwrapped_from_band(self.response[place], self.usable[place])
        return phases

    def bands(self) -> list[list[tuple[float, float] | None]]:
        """Return the lowest and highest usable frequency, Hz, by output and input; None without."""
        return [[_band_ends(self.frequency, band) for band in bands] for bands in self.usable]


def estimate_responses(
    records: Sequence[EvenSignals], frequency: np.ndarray, spectra: Spectra
) -> FrequencyResponses:
    """Return the responses of all outputs to all inputs, from all records together.

    Without references the estimate is that of least squares, which is correct where no output is
    fed back to an input. With references it is the joint input-output method: inputs and outputs
    are related to the references, which are the instruments of the regression.

    Raises
    ------
    RecordError : where all windows are longer than the records, a frequency is too low for all
        windows, steps differ, or the numbers of references and inputs differ.
    """
    step, first = records[0].step, records[0]
    m, q = len(first.outputs), len(first.inputs)
    if any(abs(record.step / step - 1.0) > 1e-6 for record in records):
        raise RecordError("rates differ", where="frequency response", remedy="resample the records")
    joint = len(first.references) > 0
    if joint and len(first.references) != q:
        what = f"{len(first.references)} references for {q} inputs"
        raise RecordError(what, where="reference", remedy="name one reference for each input")
    segments = _segments([record.stacked for record in records], step, frequency, spectra)
    return responses_of_segments(segments, frequency, spectra, m, q, joint)


def responses_of_segments(
    segments: Segments, frequency: np.ndarray, spectra: Spectra, m: int, q: int, joint: bool
) -> FrequencyResponses:
    """Return the responses from transforms of ``m`` outputs, ``q`` inputs and, where ``joint``,
    ``q`` references, in this order.

    Raises
    ------
    RecordError : where a frequency is too low for all windows.
    """
    z, instrument_rows = slice(m, m + q), slice(m + q, m + 2 * q) if joint else slice(m, m + q)
    usable_rows = segments.usable(frequency) | (spectra.tapers > 0)
    if not usable_rows.any(axis=0).all():
        lowest = lowest_frequency([segments.lengths[n] for n in segments.windows])
        what = f"no window is long enough for {frequency[~usable_rows.any(axis=0)][0]:.4g} Hz"
        remedy = f"begin the band at {lowest:.4g} Hz or higher"
        raise RecordError(what, where="frequency response", remedy=remedy)
    relaxed = None
    if spectra.derivatives == WINDOW_DERIVATIVES and not spectra.tapers:
        relaxed = segments.usable(frequency, FEWEST_PERIODS_OF_SINGLE_WINDOW)
    parts = []
    for output in range(m):
        weights, averages = _weights(segments, output, instrument_rows, usable_rows, relaxed)
        pooled = _pooled(segments, output, z, instrument_rows, weights, spectra.derivatives)
        signals = np.concatenate(
            [segments.transforms[instrument_rows, 0], segments.transforms[[output], 0]]
        )
        coherence = coherences(spectral_matrix(signals, weights))
        input_coherence = _input_coherence(segments, z, instrument_rows, weights, joint=joint)
        windows = np.array(segments.lengths)[segments.windows]
        # The geometric mean is between the harmonic one, which holds for windows of one length, and
        # the arithmetic one, which makes neighbours too independent.
        lengths = np.exp(np.log(windows) @ weights / weights.sum(axis=0))
        power_offset = _power_offset(segments, instrument_rows, weights)
        if spectra.tapers:
            power_offset = np.zeros_like(power_offset)
        parts.append((*pooled, *coherence, input_coherence, averages, lengths, power_offset))
    response, std, degrees, multiple, partial, input_coherence, averages, lengths, power_offset = (
        np.stack([part[n] for part in parts]) for n in range(9)
    )
    if joint:
        significant = _instrument_is_significant(input_coherence[0], averages)
        std = np.where(significant, std, np.maximum(std, np.abs(response)))
    result = FrequencyResponses(
        frequency,
        response,
        std,
        degrees,
        multiple,
        partial,
        input_coherence[0],
        np.zeros(response.shape, dtype=bool),
        averages,
        lengths,
        spectra,
        joint,
    )
    leaked = result.leaked
    if not spectra.tapers:
        leaked = _leaked(segments, instrument_rows, usable_rows)
    return replace(result, usable=_usable(result, power_offset), leaked=leaked)


def detrended(signals: np.ndarray) -> np.ndarray:
    """Return signals ``(S, N)`` minus the straight lines that fit them best."""
    count = signals.shape[1]
    line = np.linspace(-1.0, 1.0, count)
    level = signals.mean(axis=1, keepdims=True)
    slope = (signals @ line / max(float(line @ line), 1e-300))[:, None]
    return np.asarray(signals - level - slope * line)


def _segments(
    records: list[np.ndarray], step: float, frequency: np.ndarray, spectra: Spectra
) -> Segments:
    """Return the transforms of all signals under the windows or tapers of the settings."""
    if spectra.tapers:
        return sine_segments(records, step, spectra.tapers, frequency, spectra.derivatives)
    longest = max(signals.shape[1] for signals in records) * step
    lengths = [length for length in spectra.windows if length <= longest * (1.0 + 1e-9)]
    if not lengths:
        what = f"no window is as short as the longest record, {longest:.4g} s"
        raise RecordError(what, where="windows", remedy="give shorter windows or a longer record")
    return hann_segments(records, step, lengths, frequency, spectra.derivatives)


def _weights(
    segments: Segments, output: int, inputs: slice, usable: np.ndarray, relaxed: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights ``(R, F)`` of R segments and the numbers of averages ``(F,)``.

    A window has the weight (least error / its error)^4, divided among its segments. These weights
    may leave too few degrees of freedom for derivatives of the windows; without derivatives, a long
    window is biased, which its scatter does not show. Then only windows that have enough degrees of
    freedom alone get weight: first those of the ``usable`` segments, bool ``(R, F)``, then those of
    the ``relaxed`` ones, which are None if the regression has no derivatives.
    """
    errors, enough = _window_errors(segments, output, inputs, usable)
    weights = _by_error(segments, errors, usable)
    averages = effective_averages(weights, segments.overlap)
    q = segments.transforms[inputs].shape[0]
    short = ~_leaves_noise_degrees(averages, q)
    if relaxed is None or not short.any():
        return weights, averages
    alone = short & enough.any(axis=0)
    weights = np.where(
        alone, _by_error(segments, np.where(enough, errors, np.inf), usable), weights
    )
    # Where no usable window has enough, the longest relaxed window that has enough is taken.
    errors, enough = _window_errors(segments, output, inputs, relaxed)
    longest = enough & (np.cumsum(enough, axis=0) == 1)
    errors, alone = np.where(longest, errors, np.inf), short & ~alone & enough.any(axis=0)
    weights = np.where(alone, _by_error(segments, errors, relaxed), weights)
    return weights, effective_averages(weights, segments.overlap)


def _window_errors(
    segments: Segments, output: int, inputs: slice, usable: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared random errors ``(W, F)`` with each of W window lengths alone, smoothed
    over frequency, and whether this leaves enough degrees of freedom with derivatives, bool.
    """
    x, y = segments.transforms[inputs, 0], segments.transforms[[output], 0]
    q = x.shape[0]
    errors = np.full((len(segments.lengths), usable.shape[1]), np.inf)
    enough = np.zeros(errors.shape, dtype=bool)
    for number in range(len(segments.lengths)):
        rows = segments.windows == number
        equal_weights = usable[rows].astype(float)
        present = equal_weights.any(axis=0)
        if not present.any():
            continue
        averages = effective_averages(equal_weights, segments.overlap[rows][:, rows])
        matrix = spectral_matrix(np.concatenate([x[:, rows], y[:, rows]]), equal_weights)
        multiple, _ = coherences(matrix)
        spare = np.maximum(averages - q, 1e-3)
        squared = (1.0 - multiple) / np.maximum(multiple, 1e-9) / (2.0 * spare)
        errors[number] = np.where(present & (averages > q + 1.0), squared, np.inf)
        enough[number] = present & _leaves_noise_degrees(averages, q)
    return _smoothed(errors), enough


def _leaves_noise_degrees(
    averages: np.ndarray, q: int, derivatives: int = WINDOW_DERIVATIVES
) -> np.ndarray:
    """Return whether a number of averages leaves enough degrees of freedom with derivatives."""
    return np.asarray(2.0 * (averages - (derivatives + 1) * q) >= _LEAST_NOISE_DEGREES)


def _by_error(segments: Segments, errors: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the weights ``(R, F)`` of segments by the squared errors ``(W, F)`` of windows."""
    least = np.min(errors, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(np.isfinite(errors), (least / errors) ** (0.5 * _RANDOM_ERROR_POWER), 0.0)
    ratio = np.where(np.isfinite(ratio), ratio, 0.0)
    counts = np.bincount(segments.windows, minlength=len(segments.lengths))
    share = ratio / np.maximum(counts, 1)[:, None]
    weights = share[segments.windows] * usable
    return np.where(weights.sum(axis=0) > 0.0, weights, usable.astype(float))


def _smoothed(errors: np.ndarray) -> np.ndarray:
    """Return the geometric means of squared errors ``(W, F)`` over neighbouring frequencies."""
    smoothed = errors.copy()
    for row, error in enumerate(errors):
        finite = np.isfinite(error)
        if not finite.any():
            continue
        logs = np.where(finite, np.log(np.maximum(np.where(finite, error, 1.0), 1e-300)), 0.0)
        kernel = np.ones(min(_SMOOTHED_NEIGHBOURS, error.size))
        sums, count = np.convolve(logs, kernel, "same"), np.convolve(finite, kernel, "same")
        smoothed[row] = np.where(finite, np.exp(sums / np.maximum(count, 1.0)), np.inf)
    return smoothed


def _pooled(
    segments: Segments,
    output: int,
    inputs: slice,
    instrument_rows: slice,
    weights: np.ndarray,
    derivatives: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return response and standard deviation, ``(q, F)`` each, and degrees of freedom ``(F,)``, by
    regression with as many derivatives of the window as leave enough degrees of freedom.
    """
    y = segments.transforms[output, 0]
    q, count = inputs.stop - inputs.start, y.shape[1]
    averages = effective_averages(weights, segments.overlap)
    response, std = np.zeros((q, count), dtype=complex), np.zeros((q, count))
    degrees, remaining = np.zeros(count), np.ones(count, dtype=bool)
    for order in range(derivatives, -1, -1):
        terms = order + 1
        at_order = remaining & (_leaves_noise_degrees(averages, q, order) | (order == 0))
        if not at_order.any():
            continue
        rows = np.arange(q) * terms
        batch = max(1, _MOST_REGRESSORS_AT_ONCE // (len(y) * q * terms))
        places = np.flatnonzero(at_order)
        for at in (places[n : n + batch] for n in range(0, places.size, batch)):
            z, instruments = (
                segments.transforms[each, :terms][..., at].reshape(q * terms, -1, at.size)
                for each in (inputs, instrument_rows)
            )
            result = regress(y[:, at], z, weights[:, at], segments.overlap, instruments)
            response[:, at] = result.coefficients[:, rows].T
            std[:, at] = np.sqrt(np.einsum("fkk->fk", result.covariance).real[:, rows]).T
            degrees[at] = result.degrees
        remaining &= ~at_order
    return response, std, degrees


def _leaked(segments: Segments, inputs: slice, usable: np.ndarray) -> np.ndarray:
    """Return bool ``(q, F)``: whether the rms distance of the power of an input from a frequency
    exceeds the half-width of the main lobe. The derivative of the window multiplies the transform
    of a sine by 2 pi times its distance.
    """
    rows = segments.transforms[inputs]
    if rows.shape[1] < 2:
        return np.zeros((0, 0), dtype=bool)
    length = np.array(segments.lengths)[segments.windows][:, None] / (2.0 * math.pi)
    power, moment = (
        np.sum(usable * np.abs(factor * rows[:, order]) ** 2, axis=1)
        for order, factor in enumerate((np.ones_like(length), length))
    )
    return np.asarray(moment > MAIN_LOBE_HALF_WIDTH**2 * power)


def _power_offset(segments: Segments, inputs: slice, weights: np.ndarray) -> np.ndarray:
    """Return the mean distance ``(q, F)`` of input power from a frequency, times window length."""
    rows = segments.transforms[inputs]
    if rows.shape[1] < 2:
        return np.zeros((rows.shape[0], rows.shape[3]))
    length = np.array(segments.lengths)[segments.windows][:, None] / (2.0 * math.pi)
    power = np.sum(weights * np.abs(rows[:, 0]) ** 2, axis=1)
    moment = np.sum(weights * length * (np.conj(rows[:, 0]) * rows[:, 1]).imag, axis=1)
    return np.asarray(moment / np.maximum(power, np.finfo(float).tiny))


def _input_coherence(
    segments: Segments, inputs: slice, references: slice, weights: np.ndarray, *, joint: bool
) -> np.ndarray:
    """Return the coherence ``(q, F)`` of each input with the others, or with the references."""
    x = segments.transforms[inputs, 0]
    rows = []
    for i in range(len(x)):
        others = segments.transforms[references, 0] if joint else np.delete(x, i, axis=0)
        if not len(others):
            rows.append(np.zeros(weights.shape[1]))
            continue
        rows.append(coherences(spectral_matrix(np.concatenate([others, x[[i]]]), weights))[0])
    return np.array(rows)


def _instrument_is_significant(coherence: np.ndarray, averages: np.ndarray) -> np.ndarray:
    """Return whether the ``coherence (q, F)`` of each input with the q references is significant at
    the 5 % level, bool ``(m, q, F)``.

    Where it is not, the joint estimate tends to the negative inverse of the feedback with little
    scatter, and its confidence region is unbounded (Anderson and Rubin, 1949).
    """
    from scipy.stats import beta

    q = len(coherence)
    least = beta.ppf(0.95, q, np.maximum(averages - q, 1e-3))
    return np.asarray(coherence[None] >= least[:, None])


def _usable(responses: FrequencyResponses, power_offset: np.ndarray) -> np.ndarray:
    """Return the usable band, bool ``(m, q, F)``: the longest run of frequencies, in octaves, with
    enough coherence, a small random error, and power of the input on both sides.

    Each quantity is a median over neighbours. A joint estimate needs coherence of output and input
    with the references. ``power_offset (m, q, F)`` is the mean distance of the power of an input: a
    sweep may end within a window, and neither coherence nor scatter shows this error.
    """
    from scipy.ndimage import median_filter

    usable = np.zeros(responses.response.shape, dtype=bool)
    log_frequency = np.log(responses.frequency)
    for output, partials in enumerate(responses.partial_coherence):
        for i, partial in enumerate(partials):
            if responses.joint:
                partial = np.minimum(responses.coherence[output], responses.input_coherence[i])
            size = min(_SMOOTHED_NEIGHBOURS, partial.size)
            coherent, error, offset = (
                median_filter(each, size=size, mode="nearest")
                for each in (partial, responses.random_error[output, i], power_offset[output, i])
            )
            good = (coherent >= responses.spectra.least_coherence) & (error <= RANDOM_ERROR)
            usable[output, i] = longest_run(
                good & (np.abs(offset) <= LARGEST_POWER_OFFSET), log_frequency
            )
    return usable


def longest_run(good: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Return the longest run of ``good (F,)``, bool; ``log (F,)`` is the log of frequency."""
    longest = np.zeros(good.size, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    runs = list(zip(edges[::2], edges[1::2] - 1, strict=True))
    if runs:
        first, last = max(runs, key=lambda run: (log[run[1]] - log[run[0]], -run[0]))
        longest[first : last + 1] = True
    return longest


def _unwrapped_from_band(response: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the phases ``(F,)``, rad, unwrapped both ways from the begin of the usable band."""
    phase = np.angle(response)
    start = int(np.flatnonzero(usable)[0]) if usable.any() else 0
    ahead, behind = np.unwrap(phase[start:]), np.unwrap(phase[: start + 1][::-1])[::-1]
    return np.asarray(np.concatenate([behind[:-1], ahead]))


def _band_ends(frequency: np.ndarray, usable: np.ndarray) -> tuple[float, float] | None:
    """Return the lowest and highest usable frequency, Hz; None without any."""
    present = np.flatnonzero(usable)
    return (float(frequency[present[0]]), float(frequency[present[-1]])) if present.size else None


# ---- Default settings from the records: band, frequencies, rate, window lengths

FEWEST_SAMPLES_PER_PERIOD = 5.0  # at the highest frequency, after decimation
BAND_POWER_SHARE = 0.99  # share of the power of an input below the end of the default band
FREQUENCIES_PER_DECADE = 40
_FEWEST_FREQUENCIES = 12  # fewest frequencies of a band
WINDOW_COUNT = 4  # number of window lengths, each half of the one before
_USUAL_WINDOW_SHARE = 0.25  # length of the longest window, over that of the longest record
_LARGEST_WINDOW_SHARE = 0.5  # the same where a low frequency needs a longer window
# periods of the lowest frequency in the longest window, where the record is long enough
_PERIODS_IN_LONGEST_WINDOW = 2.5


def window_lengths(durations: Sequence[float], low: float | None = None) -> tuple[float, ...]:
    """Return the lengths of windows, s, each half of the one before.

    The longest window is a quarter of the longest record. It is longer, up to half of the record,
    where it would not hold 2.5 periods of the lowest frequency ``low``, Hz.
    """
    whole = max(durations)
    longest = _USUAL_WINDOW_SHARE * whole
    if low is not None:
        longest = min(max(longest, _PERIODS_IN_LONGEST_WINDOW / low), _LARGEST_WINDOW_SHARE * whole)
    return tuple(longest / 2**n for n in range(WINDOW_COUNT))


def input_band(records: Sequence[EvenSignals], low: float) -> tuple[float, float]:
    """Return the band, Hz, from ``low`` to the frequency below which every input has 99 % of its
    power, and at most to a fifth of the sampling rate.
    """
    step = records[0].step
    size = max(each.inputs.shape[1] for each in records)
    frequency = np.fft.rfftfreq(size, step)
    power = sum(np.abs(np.fft.rfft(detrended(each.inputs), size)) ** 2 for each in records)
    total = np.cumsum(power, axis=1)
    if not np.all(total[:, -1] > 0.0):
        raise RecordError("an input does not move", where="input", remedy="choose another part")
    first = np.argmax(total >= BAND_POWER_SHARE * total[:, -1:], axis=1)
    return low, float(
        min(max(frequency[first].max(), 4.0 * low), 1.0 / (FEWEST_SAMPLES_PER_PERIOD * step))
    )


def frequencies(low: float, high: float) -> np.ndarray:
    """Return the frequencies in Hz from ``low`` to ``high``, evenly spaced in their logarithm."""
    count = max(_FEWEST_FREQUENCIES, round(FREQUENCIES_PER_DECADE * math.log10(high / low)) + 1)
    return np.geomspace(low, high, count)


def lowest_frequency(windows: Sequence[float]) -> float:
    """Return the lowest frequency, Hz, that the longest window resolves."""
    return LEAST_PERIODS_IN_LONGEST_WINDOW / max(windows)


def decimated(records: Sequence[EvenSignals], high: float) -> tuple[list[EvenSignals], int]:
    """Return the records with every n-th sample, and n. At least five samples remain in a period of
    the frequency ``high``, Hz. All signals pass the same zero-phase filter first.
    """
    step = records[0].step
    factor = math.floor(1.0 / (FEWEST_SAMPLES_PER_PERIOD * high * step) * (1.0 + 1e-9))
    if factor < 2:
        return list(records), 1
    from scipy.signal import resample_poly

    def fewer(rows: np.ndarray) -> np.ndarray:
        return np.asarray(resample_poly(detrended(rows), 1, factor, axis=1)) if len(rows) else rows

    return [
        EvenSignals(factor * step, fewer(each.inputs), fewer(each.outputs), fewer(each.references))
        for each in records
    ], factor
