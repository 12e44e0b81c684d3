"""Frequency responses of records: composite over window lengths, several inputs, feedback; default
choices.

Composite of several windows: Tischler and Remple, "Aircraft and Rotorcraft System Identification",
2nd edition, AIAA 2012, chapter 10. Conditioned responses and partial coherence: the same, chapter
9. Random errors: Bendat and Piersol, "Random Data", 4th edition, Wiley 2010, chapters 6, 7 and 9.
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

# ---- Frequency responses of records: composite over window lengths, several inputs, feedback

_CONFIDENCE = 0.95  # probability that a band or circle holds the response
# limits of a usable response: coherence and random error of the magnitude (Tischler and Remple)
LEAST_COHERENCE = 0.6
RANDOM_ERROR = 0.2
# mean distance of an input's power from a usable frequency, times the window's length
LARGEST_POWER_OFFSET = 0.6
WINDOW_DERIVATIVES = 2  # orders of derivatives of the window in the regression
MAIN_LOBE_HALF_WIDTH = 2.0  # of a Hann window's spectrum, times the length of the window
# periods in a window that alone has enough averages for its derivatives
FEWEST_PERIODS_OF_SINGLE_WINDOW = 3.0
_LEAST_NOISE_DEGREES = 4.0  # real degrees of freedom that must be left for the noise
# power of the random error by which a window counts, Tischler and Remple's
_RANDOM_ERROR_POWER = 4.0
_MOST_REGRESSORS_AT_ONCE = 400_000  # regressors that are worked on at a time
_SMOOTHED_NEIGHBOURS = 5  # neighbours over which weights and coherence are smoothed


@dataclass(frozen=True, eq=False)
class EvenSignals:
    """Evenly sampled signals of one record.

    Attributes
    ----------
    step : s.
    inputs, outputs : ``(q, N)`` and ``(m, N)``.
    references : ``(q, N)`` or ``(0, N)``, excitations that are free of noise.
    """

    step: float
    inputs: np.ndarray
    outputs: np.ndarray
    references: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def stacked(self) -> np.ndarray:
        """All signals, outputs first, without their straight lines."""
        rows = [self.outputs, self.inputs]
        rows += [self.references] if len(self.references) else []
        return detrended(np.concatenate(rows))


@dataclass(frozen=True)
class Spectra:
    """How spectra are estimated.

    Attributes
    ----------
    windows : s, lengths of the Hann windows, the longest first.
    tapers : sine tapers of each whole record instead; 0 for windows.
    derivatives : number of derivatives of the window in the regression, which remove bias by the
        window.
    least_coherence : of the usable band.
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
    frequency : Hz, ``(F,)``.
    response : complex ``(m, q, F)``, each input's with the other inputs held.
    std : ``(m, q, F)``, standard deviation of the real and of the imaginary part; at least the
        magnitude where the references do not move an input of a joint estimate.
    degrees : ``(m, F)``, real degrees of freedom of the noise estimate behind ``std``.
    coherence : ``(m, F)``, multiple coherence of an output with all inputs; of a joint input-output
        estimate with the references.
    partial_coherence : ``(m, q, F)``; with one input the ordinary coherence.
    input_coherence : ``(q, F)``, of each input with the other inputs, zero with one; of a joint
        estimate of each input with the references.
    usable : bool ``(m, q, F)``, the usable band.
    averages : ``(m, F)``, number of independent averages.
    lengths : ``(m, F)``, s, weighted geometric mean of the windows' lengths, by which the errors of
        neighbours are correlated.
    spectra : how it was estimated.
    joint : whether it is a joint input-output estimate.
    leaked : bool ``(q, F)``, where an input (its reference) has no power of its own: what its
        transforms hold comes from beyond their main lobe. Empty with sine tapers.
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
        """Normalised random error of the magnitude, ``(m, q, F)``: standard deviation over size."""
        return np.asarray(self.std / np.maximum(np.abs(self.response), np.finfo(float).tiny))

    def half_width(self, level: float = 0.95) -> np.ndarray:
        """Half width ``(m, q, F)`` of the band of the magnitude, by Student's distribution."""
        from scipy.stats import t

        return np.asarray(t.ppf(0.5 * (1.0 + level), self.degrees)[:, None, :] * self.std)

    def radius(self) -> np.ndarray:
        """Radius ``(m, q, F)`` of the circle in the complex plane that holds the response with
        probability 0.95, by Fisher's distribution (Bendat and Piersol, section 6.2.4)."""
        from scipy.stats import f

        return np.asarray(
            np.sqrt(2.0 * f.ppf(_CONFIDENCE, 2.0, self.degrees))[:, None, :] * self.std
        )

    def phase_half_width(self) -> np.ndarray:
        """Half width ``(m, q, F)`` of the 95 % band of the phase, rad; pi if it is undetermined."""
        size = np.maximum(np.abs(self.response), np.finfo(float).tiny)
        share = self.half_width(_CONFIDENCE) / size
        return np.where(share < 1.0, np.arcsin(np.minimum(share, 1.0)), math.pi)

    def phase(self) -> np.ndarray:
        """Phases ``(m, q, F)``, rad, without jumps, continued both ways from each usable band."""
        return np.array(
            [
                [
                    _unwrapped_from_band(each, present)
                    for each, present in zip(row, usable, strict=True)
                ]
                for row, usable in zip(self.response, self.usable, strict=True)
            ]
        )

    def bands(self) -> list[list[tuple[float, float] | None]]:
        """Lowest and highest usable frequency, Hz, of each output and input; None where none is."""
        return [[_band_ends(self.frequency, each) for each in row] for row in self.usable]


def estimate_responses(
    records: Sequence[EvenSignals], frequency: np.ndarray, spectra: Spectra
) -> FrequencyResponses:
    """Estimate the responses of all outputs to all inputs from the records together.

    Without references by least squares, which is right where no output acts back on an input. With
    references by the joint input-output method: each input and each output is related to the
    references, which are instruments of the regression.

    Raises
    ------
    RecordError : records too short for every window, a frequency too low for every window, steps
        that differ, another number of references than of inputs.
    """
    step, first = records[0].step, records[0]
    m, q = len(first.outputs), len(first.inputs)
    if any(abs(each.step / step - 1.0) > 1e-6 for each in records):
        raise RecordError("rates differ", where="frequency response", remedy="resample the records")
    joint = len(first.references) > 0
    if joint and len(first.references) != q:
        what = f"{len(first.references)} references for {q} inputs"
        raise RecordError(what, where="reference", remedy="name one reference for each input")
    segments = _segments([each.stacked for each in records], step, frequency, spectra)
    return responses_of_segments(segments, frequency, spectra, m, q, joint)


def responses_of_segments(
    segments: Segments, frequency: np.ndarray, spectra: Spectra, m: int, q: int, joint: bool
) -> FrequencyResponses:
    """Estimate the responses from transforms of ``m`` outputs, ``q`` inputs and, where ``joint``,
    ``q`` references, in this order.

    Raises
    ------
    RecordError : a frequency too low for every window.
    """
    z, instrument_rows = slice(m, m + q), slice(m + q, m + 2 * q) if joint else slice(m, m + q)
    usable_rows = segments.usable(frequency) | (spectra.tapers > 0)
    if not usable_rows.any(axis=0).all():
        lowest = LEAST_PERIODS_IN_LONGEST_WINDOW / max(
            segments.lengths[n] for n in segments.windows
        )
        what = f"no window is long enough for {frequency[~usable_rows.any(axis=0)][0]:.4g} Hz"
        remedy = f"begin the band at {lowest:.4g} Hz or higher"
        raise RecordError(what, where="frequency response", remedy=remedy)
    relaxed = None
    if spectra.derivatives == WINDOW_DERIVATIVES and not spectra.tapers:
        relaxed = segments.usable(frequency, FEWEST_PERIODS_OF_SINGLE_WINDOW)
    parts = []
    for output in range(m):
        weights, averages = _weights(segments, output, instrument_rows, usable_rows, relaxed)
        response, std, degrees = _pooled(
            segments, output, z, instrument_rows, weights, spectra.derivatives
        )
        around = np.concatenate(
            [segments.transforms[instrument_rows, 0], segments.transforms[[output], 0]]
        )
        multiple, partial = coherences(spectral_matrix(around, weights))
        of_inputs = _input_coherence(segments, z, instrument_rows, weights, joint=joint)
        windows = np.array(segments.lengths)[segments.windows]
        # The geometric mean lies between the harmonic mean, which would be right for windows of one
        # length, and the arithmetic mean, by which neighbours would seem too independent.
        lengths = np.exp(np.log(windows) @ weights / weights.sum(axis=0))
        power_offset = _power_offset(segments, instrument_rows, weights)
        power_offset = power_offset if not spectra.tapers else np.zeros_like(power_offset)
        parts.append(
            (response, std, degrees, multiple, partial, of_inputs, averages, lengths, power_offset)
        )
    response, std, degrees, multiple, partial, of_inputs, averages, lengths, power_offset = (
        np.stack([part[n] for part in parts]) for n in range(9)
    )
    if joint:
        std = np.where(
            _instrument_is_significant(of_inputs[0], averages),
            std,
            np.maximum(std, np.abs(response)),
        )
    result = FrequencyResponses(
        frequency,
        response,
        std,
        degrees,
        multiple,
        partial,
        of_inputs[0],
        np.zeros(response.shape, dtype=bool),
        averages,
        lengths,
        spectra,
        joint,
    )
    leaked = (
        _leaked(segments, instrument_rows, usable_rows) if not spectra.tapers else result.leaked
    )
    return replace(result, usable=_usable(result, power_offset), leaked=leaked)


def detrended(signals: np.ndarray) -> np.ndarray:
    """Signals ``(S, N)`` without the straight lines that fit them best."""
    count = signals.shape[1]
    line = np.linspace(-1.0, 1.0, count)
    level = signals.mean(axis=1, keepdims=True)
    slope = (signals @ line / max(float(line @ line), 1e-300))[:, None]
    return np.asarray(signals - level - slope * line)


def _segments(
    records: list[np.ndarray], step: float, frequency: np.ndarray, spectra: Spectra
) -> Segments:
    if spectra.tapers:
        return sine_segments(records, step, spectra.tapers, frequency, spectra.derivatives)
    longest = max(each.shape[1] for each in records) * step
    lengths = [each for each in spectra.windows if each <= longest * (1.0 + 1e-9)]
    if not lengths:
        what = f"no window is as short as the longest record, {longest:.4g} s"
        raise RecordError(what, where="windows", remedy="give shorter windows or a longer record")
    return hann_segments(records, step, lengths, frequency, spectra.derivatives)


def _weights(
    segments: Segments, output: int, inputs: slice, usable: np.ndarray, relaxed: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Weights ``(R, F)`` of the segments, each window's by its random error, and the averages.

    A window counts as (least error / its error)^4, shared among its segments. Where that leaves too
    few degrees of freedom for derivatives of the windows, those that have enough by themselves
    count alone: a long window without derivatives is biased, and no scatter shows it.

    ``usable``, ``relaxed`` : bool ``(R, F)``, rows that may count, usually and alone; None where no
    derivatives are taken along.
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
    # Where none of the usual windows has enough, the longest of the relaxed ones that has.
    errors, enough = _window_errors(segments, output, inputs, relaxed)
    longest = enough & (np.cumsum(enough, axis=0) == 1)
    errors, alone = np.where(longest, errors, np.inf), short & ~alone & enough.any(axis=0)
    weights = np.where(alone, _by_error(segments, errors, relaxed), weights)
    return weights, effective_averages(weights, segments.overlap)


def _window_errors(
    segments: Segments, output: int, inputs: slice, usable: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Squared random errors ``(W, F)`` by each window length alone, smoothed over frequency, and
    whether it leaves degrees of freedom beside the derivatives, bool."""
    x, y = segments.transforms[inputs, 0], segments.transforms[[output], 0]
    q = x.shape[0]
    errors = np.full((len(segments.lengths), usable.shape[1]), np.inf)
    enough = np.zeros(errors.shape, dtype=bool)
    for number in range(len(segments.lengths)):
        rows = segments.windows == number
        own = usable[rows].astype(float)
        present = own.any(axis=0)
        if not present.any():
            continue
        averages = effective_averages(own, segments.overlap[rows][:, rows])
        matrix = spectral_matrix(np.concatenate([x[:, rows], y[:, rows]]), own)
        multiple, _ = coherences(matrix)
        spare = np.maximum(averages - q, 1e-3)
        squared = (1.0 - multiple) / np.maximum(multiple, 1e-9) / (2.0 * spare)
        errors[number] = np.where(present & (averages > q + 1.0), squared, np.inf)
        enough[number] = present & _leaves_noise_degrees(averages, q)
    return _smoothed(errors), enough


def _leaves_noise_degrees(
    averages: np.ndarray, q: int, derivatives: int = WINDOW_DERIVATIVES
) -> np.ndarray:
    """Return whether so many averages leave degrees of freedom beside the derivatives, bool."""
    return np.asarray(2.0 * (averages - (derivatives + 1) * q) >= _LEAST_NOISE_DEGREES)


def _by_error(segments: Segments, errors: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Weights ``(R, F)`` of the segments by the squared errors ``(W, F)`` of their windows."""
    least = np.min(errors, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(np.isfinite(errors), (least / errors) ** (0.5 * _RANDOM_ERROR_POWER), 0.0)
    ratio = np.where(np.isfinite(ratio), ratio, 0.0)
    counts = np.bincount(segments.windows, minlength=len(segments.lengths))
    share = ratio / np.maximum(counts, 1)[:, None]
    weights = share[segments.windows] * usable
    return np.where(weights.sum(axis=0) > 0.0, weights, usable.astype(float))


def _smoothed(errors: np.ndarray) -> np.ndarray:
    """Squared errors ``(W, F)``, geometric means over neighbouring frequencies of one window."""
    out = errors.copy()
    for row, each in enumerate(errors):
        finite = np.isfinite(each)
        if not finite.any():
            continue
        logs = np.where(finite, np.log(np.maximum(np.where(finite, each, 1.0), 1e-300)), 0.0)
        kernel = np.ones(min(_SMOOTHED_NEIGHBOURS, each.size))
        sums, count = np.convolve(logs, kernel, "same"), np.convolve(finite, kernel, "same")
        out[row] = np.where(finite, np.exp(sums / np.maximum(count, 1.0)), np.inf)
    return out


def _pooled(
    segments: Segments,
    output: int,
    inputs: slice,
    instrument_rows: slice,
    weights: np.ndarray,
    derivatives: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Response and deviation ``(q, F)`` and degrees ``(F,)`` by regression with as many derivatives
    of the window as leave degrees of freedom."""
    y = segments.transforms[output, 0]
    q, count = inputs.stop - inputs.start, y.shape[1]
    averages = effective_averages(weights, segments.overlap)
    response, std = np.zeros((q, count), dtype=complex), np.zeros((q, count))
    degrees, open_ = np.zeros(count), np.ones(count, dtype=bool)
    for order in range(derivatives, -1, -1):
        terms = order + 1
        here = open_ & (_leaves_noise_degrees(averages, q, order) | (order == 0))
        if not here.any():
            continue
        rows = np.arange(q) * terms
        together = max(1, _MOST_REGRESSORS_AT_ONCE // (len(y) * q * terms))
        places = np.flatnonzero(here)
        for at in (places[n : n + together] for n in range(0, places.size, together)):
            z, instruments = (
                segments.transforms[each, :terms][..., at].reshape(q * terms, -1, at.size)
                for each in (inputs, instrument_rows)
            )
            result = regress(y[:, at], z, weights[:, at], segments.overlap, instruments)
            response[:, at] = result.coefficients[:, rows].T
            std[:, at] = np.sqrt(np.einsum("fkk->fk", result.covariance).real[:, rows]).T
            degrees[at] = result.degrees
        open_ &= ~here
    return response, std, degrees


def _leaked(segments: Segments, inputs: slice, usable: np.ndarray) -> np.ndarray:
    """Return bool ``(q, F)``: whether the root mean square distance of an input's power from a
    frequency exceeds the half width of the main lobe. The transforms under the window's derivative
    are 2 pi distance times as large.
    """
    rows = segments.transforms[inputs]
    if rows.shape[1] < 2:
        return np.zeros((0, 0), dtype=bool)
    length = np.array(segments.lengths)[segments.windows][:, None] / (2.0 * math.pi)
    power, away = (
        np.sum(usable * np.abs(factor * rows[:, order]) ** 2, axis=1)
        for order, factor in enumerate((np.ones_like(length), length))
    )
    return np.asarray(away > MAIN_LOBE_HALF_WIDTH**2 * power)


def _power_offset(segments: Segments, inputs: slice, weights: np.ndarray) -> np.ndarray:
    """Mean distance ``(q, F)`` of an input's power from a frequency, in units of one over the
    length of the window; zero without derivatives."""
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
    """Coherence ``(q, F)`` of each input with the other inputs, or with the references."""
    x = segments.transforms[inputs, 0]
    rows = []
    for one in range(len(x)):
        others = segments.transforms[references, 0] if joint else np.delete(x, one, axis=0)
        if not len(others):
            rows.append(np.zeros(weights.shape[1]))
            continue
        rows.append(coherences(spectral_matrix(np.concatenate([others, x[[one]]]), weights))[0])
    return np.array(rows)


def _instrument_is_significant(coherence: np.ndarray, averages: np.ndarray) -> np.ndarray:
    """Return whether each input's coherence ``(q, F)`` with the q references is significant with 95
    %, bool ``(m, q, F)``.

    Elsewhere the joint estimate tends to the negative inverse of the feedback with little scatter,
    and its confidence region is unbounded (Anderson and Rubin, 1949).
    """
    from scipy.stats import beta

    q = len(coherence)
    least = beta.ppf(0.95, q, np.maximum(averages - q, 1e-3))
    return np.asarray(coherence[None] >= least[:, None])


def _usable(responses: FrequencyResponses, power_offset: np.ndarray) -> np.ndarray:
    """Return the longest run of frequencies, in octaves, whose coherence and random error reach
    their limits and whose input has power on both sides.

    All are medians over neighbours. A joint estimate wants the coherence of output and of input
    with the references. ``power_offset`` : mean distance ``(m, q, F)`` of the input's power; where
    a sweep ends within a window it lies on one side, and neither coherence nor scatter shows the
    error.
    """
    from scipy.ndimage import median_filter

    out = np.zeros(responses.response.shape, dtype=bool)
    log = np.log(responses.frequency)
    for output, row in enumerate(responses.partial_coherence):
        for one, partial in enumerate(row):
            if responses.joint:
                partial = np.minimum(responses.coherence[output], responses.input_coherence[one])
            size = min(_SMOOTHED_NEIGHBOURS, partial.size)
            coherent, error, away = (
                median_filter(each, size=size, mode="nearest")
                for each in (
                    partial,
                    responses.random_error[output, one],
                    power_offset[output, one],
                )
            )
            good = (coherent >= responses.spectra.least_coherence) & (error <= RANDOM_ERROR)
            out[output, one] = longest_run(good & (np.abs(away) <= LARGEST_POWER_OFFSET), log)
    return out


def longest_run(good: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Return the longest stretch of ``good`` ``(F,)``, bool, by the logarithm of the frequency."""
    out = np.zeros(good.size, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    runs = list(zip(edges[::2], edges[1::2] - 1, strict=True))
    if runs:
        first, last = max(runs, key=lambda run: (log[run[1]] - log[run[0]], -run[0]))
        out[first : last + 1] = True
    return out


def _unwrapped_from_band(response: np.ndarray, usable: np.ndarray) -> np.ndarray:
    phase = np.angle(response)
    start = int(np.flatnonzero(usable)[0]) if usable.any() else 0
    ahead, behind = np.unwrap(phase[start:]), np.unwrap(phase[: start + 1][::-1])[::-1]
    return np.asarray(np.concatenate([behind[:-1], ahead]))


def _band_ends(frequency: np.ndarray, usable: np.ndarray) -> tuple[float, float] | None:
    present = np.flatnonzero(usable)
    return (float(frequency[present[0]]), float(frequency[present[-1]])) if present.size else None


# ---- What an estimate needs and a record suggests: band, frequencies, rate, window lengths

FEWEST_SAMPLES_PER_PERIOD = 5.0  # at the highest frequency, after decimation
BAND_POWER_SHARE = 0.99  # share of the inputs' power in the default band
FREQUENCIES_PER_DECADE = 40
_FEWEST_FREQUENCIES = 12  # frequencies of a narrow band
WINDOW_COUNT = 4  # lengths, each half of the one before
_USUAL_WINDOW_SHARE = 0.25  # usual longest window, as a share of the longest record
_LARGEST_WINDOW_SHARE = 0.5  # limit of the longest window, as a share of the longest record
# periods of the lowest frequency in the longest window, where the record is long enough
_PERIODS_IN_LONGEST_WINDOW = 2.5


def window_lengths(durations: Sequence[float], low: float | None = None) -> tuple[float, ...]:
    """Return the lengths of windows, s, each half of the one before.

    The longest is a quarter of the longest record. Where that does not hold 2.5 periods of the
    lowest frequency ``low``, Hz, it is longer, at most half of the record.
    """
    whole = max(durations)
    longest = _USUAL_WINDOW_SHARE * whole
    if low is not None:
        longest = min(max(longest, _PERIODS_IN_LONGEST_WINDOW / low), _LARGEST_WINDOW_SHARE * whole)
    return tuple(longest / 2**n for n in range(WINDOW_COUNT))


def input_band(records: Sequence[EvenSignals], low: float) -> tuple[float, float]:
    """Return the band, Hz, from ``low`` to the frequency below which the inputs have 99 % of their
    power, at most a fifth of the rate; of several inputs the one that reaches highest counts.
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
    """The records with every n-th sample after a zero-phase filter, the same for all signals, so
    that five samples a period are left at ``high``, Hz; and n, 1 where nothing is to be left
    out."""
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
