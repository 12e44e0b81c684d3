"""Residuals of a diagnosis in words: for each channel their autocorrelation, frequencies, window of
the largest residual, and correlated signal; and the evidence for effects if the residuals are not
noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ident.statistics.residual_spectrum import autocovariance
from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Claim, Diagnosis, FittedRecord, Quantity
from ident.tracing.whiteness import FEWEST_SAMPLES, RUNAWAY_RESIDUAL, ResidualPart, residual_part
from scenarios.diagnosis.wording import is_unexplained
from scenarios.files.user_models import is_of_aircraft
from scenarios.report.quantities import CHANNELS, displayed, shown_in, spaced

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing

LARGE_RESIDUAL_WINDOW = 2.0  # s, window of a large residual: about one short period
LARGEST_RESIDUAL_SHIFT = 0.5  # s, largest lag of a correlation
SMALLEST_CORRELATION = 0.25  # a smaller one explains less than a sixteenth of the power
# Sigmas of the correlation of independent series (Bartlett). A correlation must exceed them,
# because the largest of a few dozen signals is reported.
CORRELATION_SIGMAS = 4.0
SIMILAR_SIGNIFICANCE = 0.9  # of the largest significance; above it, a simpler signal is preferred
POWER_SHARE = 0.8  # share of the power below the reported frequency
FEWEST_FREQUENCIES = 5  # fewest frequencies of a spectrum from which a peak is reported
FEWEST_LAGS = 10  # fewest lags of an autocorrelation in a variance


@dataclass(frozen=True)
class CorrelatedSignal:
    """The signal with which a residual correlates most.

    Attributes
    ----------
    name : an input or output.
    form : ``"itself"``, ``"rate"``, ``"square"``, or ``"product"`` with the record's first input.
    correlation : correlation coefficient.
    lag : lag of the residual behind the signal, s.
    """

    name: str
    form: str
    correlation: float
    lag: float


@dataclass(frozen=True)
class ChannelResidual:
    """Residual of one channel over all fitted records.

    Attributes
    ----------
    channel, unit : name and unit of the channel.
    rms : root mean square, in the channel's unit.
    correlation : correlation of neighbouring samples.
    peak : frequency of the largest power density, Hz.
    frequency_below_80_percent : frequency below which 80 % of the power lies, Hz.
    record : record (from 0) of the window with the largest mean square.
    begin, end : limits of this window, s.
    window_ratio : root mean square in this window over ``rms``.
    correlated_signal : the signal with the most significant correlation, or None.
    """

    channel: str
    unit: str
    rms: float
    correlation: float
    peak: float
    frequency_below_80_percent: float
    record: int
    begin: float
    end: float
    window_ratio: float
    correlated_signal: CorrelatedSignal | None


def channel_residual(fitted: Sequence[FittedRecord], channel: str) -> ChannelResidual | None:
    """Describe the residual of one channel; None if no record has enough fitted samples of it.

    The residual is correlated with inputs and simulated outputs, which have no noise, with their
    rates and squares, and with their products with the first input. Lags go up to half a second
    either way. Bartlett's formula gives the variance of the correlation of independent coloured
    series: the sum of the products of their autocorrelations.
    """
    parts = [
        residual_part(item, channel)
        for item in fitted
        if channel in item.channels and channel in item.record.output_names
    ]
    parts = [part for part in parts if np.count_nonzero(part.used) >= FEWEST_SAMPLES]
    if not parts:
        return None
    count = sum(int(np.count_nonzero(part.used)) for part in parts)
    power = sum(float(part.residual @ part.residual) for part in parts)
    if power <= 0.0:
        return None
    rms = float(np.sqrt(power / count))
    neighbours = sum(float(part.residual[1:] @ part.residual[:-1]) for part in parts) / power
    peak, frequency_below = _frequencies(parts)
    item, begin, end, window_ratio = _largest_window(parts, rms)
    return ChannelResidual(
        channel,
        item.record[channel].unit,
        rms,
        neighbours,
        peak,
        frequency_below,
        next(number for number, other in enumerate(fitted) if other is item),
        begin,
        end,
        window_ratio,
        _most_correlated_signal(parts),
    )


def _frequencies(parts: Sequence[ResidualPart]) -> tuple[float, float]:
    """Return the frequency of the largest power density and the frequency below which
    ``POWER_SHARE`` of the power lies, Hz.

    The spectrum has a Hann window; it is averaged over records. The peak is searched in the mean of
    three neighbouring frequencies.
    """
    highest = min(0.5 / part.interval for part in parts)
    lowest = max(1.0 / (part.interval * len(part.residual)) for part in parts)
    hertz = np.arange(lowest, highest, lowest)
    if len(hertz) < FEWEST_FREQUENCIES:
        return lowest, highest
    density = np.zeros(len(hertz))
    for part in parts:
        count = len(part.residual)
        square = np.abs(np.fft.rfft(part.residual * np.hanning(count))) ** 2
        density += np.interp(hertz, np.fft.rfftfreq(count, part.interval), square) * part.interval
    smooth = np.convolve(np.pad(density, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
    share = np.cumsum(density) / density.sum()
    below = min(int(np.searchsorted(share, POWER_SHARE)), len(hertz) - 1)
    return float(hertz[np.argmax(smooth)]), float(hertz[below])


def _largest_window(
    parts: Sequence[ResidualPart], rms: float
) -> tuple[FittedRecord, float, float, float]:
    """Return the window with the largest mean square: record, begin (s), end (s), and root mean
    square over ``rms``. At least half of the window must be measured.
    """
    best = (parts[0].item, 0.0, 0.0, -1.0)
    for part in parts:
        time = part.item.record.time
        size = min(max(3, round(LARGE_RESIDUAL_WINDOW / part.interval)), len(time))
        squares, counts = (
            np.convolve(x, np.ones(size), mode="valid")
            for x in (part.residual**2, part.used.astype(float))
        )
        mean = np.where(counts >= 0.5 * size, squares / np.maximum(counts, 1.0), -1.0)
        first = int(np.argmax(mean))
        if mean[first] > best[3]:
            last = first + size - 1
            best = (part.item, float(time[first]), float(time[last]), float(mean[first]))
    return (*best[:3], float(np.sqrt(max(best[3], 0.0))) / rms)


def _most_correlated_signal(parts: Sequence[ResidualPart]) -> CorrelatedSignal | None:
    """Return the signal with the most significant correlation; None if none is significant."""
    interval = max(part.interval for part in parts)
    largest = int(LARGEST_RESIDUAL_SHIFT / interval)
    lags = interval * np.arange(-largest, largest + 1)
    power = sum(float(part.residual @ part.residual) for part in parts)
    significant: list[tuple[float, CorrelatedSignal]] = []  # significance, signal
    for name, form in _signals(parts):
        signals = [_signal(part, name, form) for part in parts]
        pairs = list(zip(parts, signals, strict=True))
        powers = [float(signal @ signal) for signal in signals]
        if min(powers) <= 0.0:
            continue
        scale = np.sqrt(sum(powers) * power)
        correlations = sum(_correlations(part, signal, lags) for part, signal in pairs) / scale
        sigma = np.sqrt(sum(_variance(part.residual, signal) for part, signal in pairs)) / scale
        at = int(np.argmax(np.abs(correlations)))
        size = abs(correlations[at])
        if size > SMALLEST_CORRELATION and size > CORRELATION_SIGMAS * sigma:
            found = CorrelatedSignal(name, form, float(correlations[at]), float(lags[at]))
            significant.append((size / sigma, found))
    # Simple forms come first: signal, rate, square, product.
    best = max((significance for significance, _ in significant), default=0.0)
    return next(
        (
            signal
            for significance, signal in significant
            if significance >= SIMILAR_SIGNIFICANCE * best
        ),
        None,
    )


def _signals(parts: Sequence[ResidualPart]) -> list[tuple[str, str]]:
    """Return name and form of each signal that all records have."""
    shared = [
        set(part.item.record.input_names)
        | set(part.item.channels) & set(part.item.record.output_names)
        for part in parts
    ]
    first = parts[0].item
    names = [
        name
        for name in (*first.record.input_names, *first.channels)
        if all(name in signals for signals in shared)
    ]
    products = [
        (name, "product") for name in names if first.record.input_names[:1] not in ((), (name,))
    ]
    return [*((name, form) for form in ("itself", "rate", "square") for name in names), *products]


def _signal(part: ResidualPart, name: str, form: str) -> np.ndarray:
    """Return a form of an input or simulated output (see `CorrelatedSignal`), minus its mean."""
    item = part.item
    if name in item.record.input_names:
        values = item.record[name].values
    else:
        row = item.channels.index(name)
        known = item.record[name].valid & np.isfinite(item.after[row])
        if np.count_nonzero(known) < FEWEST_SAMPLES:
            return np.zeros(len(part.residual))
        time = item.record.time
        values = np.clip(
            np.interp(time, time[known], (item.record[name].values - item.after[row])[known]),
            -RUNAWAY_RESIDUAL,
            RUNAWAY_RESIDUAL,
        )
    values = values - values.mean()
    if form == "rate":
        values = np.gradient(values, item.record.time)
    elif form == "square":
        values = values**2
    elif form == "product":
        control = item.record[item.record.input_names[0]].values
        values = values * (control - control.mean())
    return np.where(part.used, values - values[part.used].mean(), 0.0)


def _correlations(part: ResidualPart, signal: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return the sum of products of the residual and the signal for each lag (s) of the residual
    behind the signal.
    """
    size = 1 << int(np.ceil(np.log2(2 * len(signal))))  # no lag wraps around
    product = np.fft.rfft(part.residual, size) * np.conj(np.fft.rfft(signal, size))
    sums = np.fft.irfft(product, size)
    return np.asarray(sums[np.round(lags / part.interval).astype(int) % size])


def _variance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the variance of the sum of products of two independent series (Bartlett, 1946)."""
    lags = max(FEWEST_LAGS, len(a) // 5)
    return len(a) * max(
        float(
            2.0 * np.sum(autocovariance(a, lags) * autocovariance(b, lags))
            - autocovariance(a, 0)[0] * autocovariance(b, 0)[0]
        ),
        SMALLEST_VARIANCE,
    )


SMALLEST_VARIANCE = 1e-300  # keeps a quotient finite
ROUNDING = 1e-9  # s, lag that is rounding
LARGEST_STD = 1e30  # stands for an infinite standard deviation
MOST_COMPARED_PARAMETERS = 2  # parameters of an effect that are printed for each record
MOST_FAILED_TESTS = 2  # failed tests that are named one by one
MOST_DECIMALS = 6  # most decimals of a value
USUAL_DECIMALS = 3  # decimals of a value without a known sigma
FORMS = {  # form of a correlated signal in words
    "itself": "{}",
    "rate": "the rate of {}",
    "square": "the square of {}",
    "product": "the product of {} and the {control}",
}
DISAGREEING_SIGMAS = 2.0  # scatter of the records' values, in sigmas, above which they disagree
SMALLEST_WINDOW_RATIO = 1.6  # multiple of the rms from which a window is reported


def evidence_sentences(claim: Claim) -> list[str]:
    """Return sentences on z of Vuong's test for an effect (``claim.spread``, None if the residual
    is noise) and on its values from each record; empty if the residual is noise.
    """
    if claim.spread is None:
        return []
    sentences = []
    if math.isfinite(claim.spread):
        sentences.append(f"Vuong's z over blocks of a second is {claim.spread:.1f}")
    values, disagreement = by_record_text(claim.by_record), disagreement_text(claim)
    if values:
        sentence = f"from each of {len(claim.by_record)} records: {values}"
        sentences.append(f"{sentence}, but {disagreement}" if disagreement else sentence)
    return sentences


def disagreement_text(claim: Claim) -> str:
    """Return the parameters whose values from single records disagree; empty if all agree."""
    if len(claim.by_record) < 2:
        return ""
    sentences = []
    for name in claim.by_record[0]:
        quantities = [parameters[name] for parameters in claim.by_record]
        values = np.array([quantity.value for quantity in quantities])
        sigmas = np.minimum([quantity.std for quantity in quantities], LARGEST_STD)
        weight = sigmas**-2
        mean = float(values @ weight / weight.sum())
        scatter = math.sqrt(float(np.sum(((values - mean) / sigmas) ** 2)) / (len(values) - 1))
        if scatter > DISAGREEING_SIGMAS:
            sentences.append(f"{name} differs between them by {scatter:.1f} of their sigmas")
    return "; ".join(sentences)


def by_record_text(by_record: Sequence[Mapping[str, Quantity]]) -> str:
    """Return the values from each record with their unit: ``"0.058, 0.063, 0.060 s"``.

    Effects with more than two parameters, such as curves, give an empty text: their parameters are
    correlated.
    """
    names = list(by_record[0]) if by_record else []
    if not 0 < len(names) <= MOST_COMPARED_PARAMETERS:
        return ""
    sentences = []
    for name in names:
        rows = [displayed(parameters[name], name) for parameters in by_record if name in parameters]
        stds = [std for _, std, _ in rows if 0.0 < std < math.inf]
        decimals = max(0, -math.floor(math.log10(min(stds)))) if stds else USUAL_DECIMALS
        decimals = min(decimals, MOST_DECIMALS)
        unit = rows[0][2] if rows[0][2] != "1" else ""
        sentence = ", ".join(f"{value:.{decimals}f}" for value, _, _ in rows)
        if len(names) > 1 or not unit:
            sentence = f"{name} {sentence}"
        if unit:
            sentence += f" {unit}"
        sentences.append(sentence)
    return "; ".join(sentences)


def overflow_sentence(count: int) -> str:
    """Return a sentence on the ``count`` computations that overflowed and were skipped."""
    several = f"{count} computations" if count > 1 else "one computation"
    return (
        f"{several} of the search left the range of numbers: what they would have shown is left "
        "out; look for wild samples and wrong units"
    )


def warnings_of(tracing: Tracing) -> list[str]:
    """Return the warnings of a diagnosis. Sentences on the residuals follow if they are not white.

    Many failed tests of whiteness are summed up in one sentence. Without an accepted effect, the
    residuals are those of the declared model.
    """
    d = tracing.diagnosis
    overflows = [overflow_sentence(tracing.overflows)] if tracing.overflows else []
    if is_unexplained(d):
        sentences = [caution.sentence for caution in d.warnings if caution.test is None]
        declared = [replace(item, after=item.before) for item in d.fitted]
        channels = _channels([test for test in d.tests_before if not test.passed])
        residuals = _residual_sentences(tracing, declared, channels)
        return [
            *sentences,
            *overflows,
            *(f"with the declared model, {sentence}" for sentence in residuals),
        ]
    failed = [caution.test for caution in d.warnings if caution.test is not None]
    channels = _channels(failed)
    summed_up = len(failed) > MOST_FAILED_TESTS
    sentences = [
        caution.sentence for caution in d.warnings if caution.test is None or not summed_up
    ]
    sentences += overflows
    if summed_up:
        sentences.append(
            f"{len(failed)} of {len(d.tests_after)} tests for whiteness fail in "
            f"{', '.join(channels)}"
        )
    return [*sentences, *_residual_sentences(tracing, d.fitted, channels)]


def _channels(tests: Sequence[ResidualTest]) -> list[str]:
    return list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))


def _residual_sentences(
    tracing: Tracing, fitted: Sequence[FittedRecord], channels: Sequence[str]
) -> list[str]:
    residuals = [channel_residual(fitted, channel) for channel in channels]
    return [residual_sentence(residual, tracing) for residual in residuals if residual is not None]


def residual_sentence(residual: ChannelResidual, tracing: Tracing) -> str:
    """Return a sentence on the residual of one channel: size, autocorrelation, frequencies, window
    of the largest residual, and correlated signal.
    """
    factor, unit = shown_in(residual.unit, residual.channel)
    parts = [
        f"residual of the {_spoken(residual.channel, tracing)}: "
        f"rms {factor * residual.rms:.3g}{spaced(unit)}, "
        f"neighbouring samples correlated by {residual.correlation:.2f}",
        f"most power near {residual.peak:.2g} Hz, four fifths of it below "
        f"{residual.frequency_below_80_percent:.2g} Hz",
    ]
    if residual.window_ratio > SMALLEST_WINDOW_RATIO:
        record = tracing.diagnosis.fitted[residual.record].record.name
        parts.append(
            f"largest in {record} from {residual.begin:.1f} to {residual.end:.1f} s, "
            f"{residual.window_ratio:.1f} times its rms"
        )
    else:
        parts.append("about alike everywhere")
    correlated = residual.correlated_signal
    if correlated is None:
        parts.append(
            "correlates with no input and no channel, nor their rates, squares and products"
        )
        return "; ".join(parts)
    control = next(iter(tracing.records[0].input_names), "input")
    signal = FORMS[correlated.form].format(
        f"the {_spoken(correlated.name, tracing)}", control=control
    )
    numbers = f"correlation {correlated.correlation:+.2f}"
    if abs(correlated.lag) > ROUNDING:
        side = "later" if correlated.lag > 0 else "earlier"
        numbers += f", residual {abs(correlated.lag):.2g} s {side}"
    return "; ".join([*parts, f"correlates with {signal} ({numbers})"])


def scatter_text(d: Diagnosis, name: str) -> str:
    """Return ``" (run-to-run scatter 0.8)"`` for a derivative; empty if it is not known."""
    return f" (run-to-run scatter {d.scatter[name]:.2g})" if name in d.scatter else ""


def _spoken(name: str, tracing: Tracing) -> str:
    """Return a channel in words; a user's own model keeps its names."""
    return CHANNELS.get(name, name.replace("_", " ")) if is_of_aircraft(tracing.model) else name
