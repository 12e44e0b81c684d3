"""Residuals of a diagnosis in words: colour, frequencies, times and correlates by channel; evidence
for an effect where they are not noise.
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
from scenarios.diagnosis.report.wording import nothing_stands
from scenarios.files.user_models import is_of_aircraft
from scenarios.report.quantities import CHANNELS, displayed, shown_in, spaced

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing

LARGE_RESIDUAL_WINDOW = 2.0  # s, window of a large residual: about one short period
LARGEST_RESIDUAL_SHIFT = 0.5  # s, largest lag of a correlation
WORTH_A_WORD = 0.25  # a smaller correlation explains less than a sixteenth of the power
CORRELATE_SIGMAS = (
    4.0  # sigmas of chance correlation (Bartlett); the best of a few dozen signals is reported
)


@dataclass(frozen=True)
class Company:
    """Signal that a residual correlates with most.

    ``form``: ``"itself"``, ``"rate"``, ``"square"``, or ``"product"`` with the record's first
    input. ``later``: lag of the residual, s.
    """

    name: str
    form: str
    correlation: float
    later: float


@dataclass(frozen=True)
class Leftover:
    """Residual of one channel over all fitted records.

    Attributes
    ----------
    rms : in the channel's unit.
    correlation : of neighbouring samples.
    peak : frequency of the largest power density, Hz.
    below : frequency below which 80 % of the power lies, Hz.
    record, begin, end : record (from 0) and time (s) of the window with the largest mean square.
    times : root mean square in this window over ``rms``.
    company : correlated signal, or None.
    """

    channel: str
    unit: str
    rms: float
    correlation: float
    peak: float
    below: float
    record: int
    begin: float
    end: float
    times: float
    company: Company | None


def left_over(fitted: Sequence[FittedRecord], channel: str) -> Leftover | None:
    """Describe the residuals of one channel after the fit; None if fewer than 20 samples of it
    were used.

    It is compared with inputs and simulated outputs (which hold no noise), their rates, squares and
    products with the first input, shifted by up to half a second either way. What chance does to a
    correlation of two coloured series is Bartlett's sum of the products of their autocorrelations.
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
    peak, below = _frequencies(parts)
    where, begin, end, times = _when(parts, rms)
    number = next(n for n, item in enumerate(fitted) if item is where)
    return Leftover(
        channel,
        where.record[channel].unit,
        rms,
        neighbours,
        peak,
        below,
        number,
        begin,
        end,
        times,
        _company(parts),
    )


def _frequencies(parts: Sequence[ResidualPart]) -> tuple[float, float]:
    """Return the frequency of the largest power and that below which four fifths lie, Hz; Hann
    window, mean over records, three neighbours smoothed.
    """
    highest = min(0.5 / part.interval for part in parts)
    lowest = max(1.0 / (part.interval * len(part.residual)) for part in parts)
    hertz = np.arange(lowest, highest, lowest)
    if len(hertz) < 5:
        return lowest, highest
    total = np.zeros(len(hertz))
    for part in parts:
        found = np.abs(np.fft.rfft(part.residual * np.hanning(len(part.residual)))) ** 2
        total += (
            np.interp(hertz, np.fft.rfftfreq(len(part.residual), part.interval), found)
            * part.interval
        )
    smooth = np.convolve(np.pad(total, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
    share = np.cumsum(total) / total.sum()
    return float(hertz[np.argmax(smooth)]), float(
        hertz[min(int(np.searchsorted(share, 0.8)), len(hertz) - 1)]
    )


def _when(parts: Sequence[ResidualPart], rms: float) -> tuple[FittedRecord, float, float, float]:
    """Record, begin, end and size of the window with the largest mean square; half of it at least
    must be measured.
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
        at = int(np.argmax(mean))
        if mean[at] > best[3]:
            best = (part.item, float(time[at]), float(time[at + size - 1]), float(mean[at]))
    return (*best[:3], float(np.sqrt(max(best[3], 0.0))) / rms)


def _company(parts: Sequence[ResidualPart]) -> Company | None:
    """Return the most certain correlation with a signal, where one is worth a word."""
    found: list[tuple[float, Company]] = []
    for name, form in _signals(parts):
        series = [_signal(part, name, form) for part in parts]
        sizes = [float(s @ s) for s in series]
        if min(sizes) <= 0.0:
            continue
        interval = max(part.interval for part in parts)
        shifts = np.arange(
            -int(LARGEST_RESIDUAL_SHIFT / interval), int(LARGEST_RESIDUAL_SHIFT / interval) + 1
        )
        scale = np.sqrt(sum(sizes) * sum(float(part.residual @ part.residual) for part in parts))
        r = (
            sum(
                _correlations(part, s, shifts * interval)
                for part, s in zip(parts, series, strict=True)
            )
            / scale
        )
        chance = (
            np.sqrt(sum(_chance(part.residual, s) for part, s in zip(parts, series, strict=True)))
            / scale
        )
        at = int(np.argmax(np.abs(r)))
        if abs(r[at]) > WORTH_A_WORD and abs(r[at]) > CORRELATE_SIGMAS * chance:
            found.append(
                (
                    abs(r[at]) / chance,
                    Company(name, form, float(r[at]), float(shifts[at] * interval)),
                )
            )
    # Of nearly equal correlations, the simplest: signal, then rate, then square.
    best = max((sure for sure, _ in found), default=0.0)
    return next((company for sure, company in found if sure >= 0.9 * best), None)


def _signals(parts: Sequence[ResidualPart]) -> list[tuple[str, str]]:
    shared = [
        set(part.item.record.input_names)
        | set(part.item.channels) & set(part.item.record.output_names)
        for part in parts
    ]
    first = parts[0].item
    names = [
        name
        for name in (*first.record.input_names, *first.channels)
        if all(name in each for each in shared)
    ]
    products = [
        (name, "product") for name in names if first.record.input_names[:1] not in ((), (name,))
    ]
    return [*((name, form) for form in ("itself", "rate", "square") for name in names), *products]


def _signal(part: ResidualPart, name: str, form: str) -> np.ndarray:
    """Return a form of an input or fitted output (see `Company`), minus its mean."""
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


def _correlations(part: ResidualPart, signal: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Sum of products of the residual with the signal ``later`` seconds before it."""
    n = len(signal)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    every = np.fft.irfft(
        np.fft.rfft(part.residual, size) * np.conj(np.fft.rfft(signal, size)), size
    )
    return np.asarray(every[np.round(later / part.interval).astype(int) % size])


def _chance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the variance of the sum of products of two independent series (Bartlett, 1946)."""
    lags = max(10, len(a) // 5)
    return len(a) * max(
        float(
            2.0 * np.sum(autocovariance(a, lags) * autocovariance(b, lags))
            - autocovariance(a, 0)[0] * autocovariance(b, 0)[0]
        ),
        1e-300,
    )


FEW_PARAMETERS = 2  # parameters that are compared between records
FORMS = {
    "itself": "{}",
    "rate": "the rate of {}",
    "square": "the square of {}",
    "product": "the product of {} and the {control}",
}
# combined sigmas between the joint value and the mean of the records
DISAGREEING_SIGMAS = 2.0
LARGEST_SHOWN = 1e30
LARGEST_EVEN_PEAK = 1.6  # multiple of the rms below which no window is reported


def evidence_sentences(claim: Claim) -> list[str]:
    """Return sentences on the spread of the evidence for an effect, and on its values from each
    record; empty if the residual is noise.
    """
    if claim.spread is None:
        return []
    sentence = (
        f"its log evidence is {claim.spread:.1f} times the scatter of that between blocks of a "
        "second"
        if math.isfinite(claim.spread)
        else ""
    )
    values, apart = by_record_text(claim.by_record), apart_text(claim)
    each = f"from each of {len(claim.by_record)} records: {values}" if values else ""
    return [part for part in (sentence, f"{each}, but {apart}" if each and apart else each) if part]


def apart_text(claim: Claim) -> str:
    """Return where values of the records differ by more than their sigmas; empty if they agree."""
    sentences = []
    for name in claim.by_record[0] if len(claim.by_record) > 1 else ():
        each = [found[name] for found in claim.by_record]
        values = np.array([q.value for q in each])
        sigmas = np.minimum([q.std for q in each], LARGEST_SHOWN)
        weight = sigmas**-2
        mean = float(values @ weight / weight.sum())
        scatter = math.sqrt(float(np.sum(((values - mean) / sigmas) ** 2)) / (len(values) - 1))
        if scatter > DISAGREEING_SIGMAS:
            sentences.append(f"{name} differs between them by {scatter:.1f} of their sigmas")
    return "; ".join(sentences)


def by_record_text(by_record: Sequence[Mapping[str, Quantity]]) -> str:
    """Return the values from each record with their unit: ``"0.058, 0.063, 0.060 s"``; empty for a
    curve, whose numbers trade off.
    """
    names = list(by_record[0]) if by_record else []
    if not 0 < len(names) <= FEW_PARAMETERS:
        return ""
    sentences = []
    for name in names:
        shown = [displayed(each[name], name) for each in by_record if name in each]
        known = [std for _, std, _ in shown if 0.0 < std < math.inf]
        digits = max(0, -math.floor(math.log10(min(known)))) if known else 3
        unit = shown[0][2] if shown[0][2] not in ("", "1") else ""
        values = ", ".join(f"{value:.{min(digits, 6)}f}" for value, _, _ in shown)
        sentences.append(
            f"{f'{name} ' if len(names) > 1 or not unit else ''}{values}{f' {unit}' if unit else ''}"  # noqa: E501
        )
    return "; ".join(sentences)


def overflow_sentence(count: int) -> str:
    """One line on the computations that were left out."""
    several = f"{count} computations" if count > 1 else "one computation"
    return (
        f"{several} of the search left the range of numbers: what they would have shown is left "
        "out; look for wild samples and wrong units"
    )


def warnings_of(tracing: Tracing) -> list[str]:
    """Return the warnings, with a description of each channel's residual instead of failed tests.

    Without an accepted effect, the residuals are those of the declared model.
    """
    d = tracing.diagnosis
    if nothing_stands(d):
        sentences = [
            *(caution.sentence for caution in d.warnings if caution.test is None),
            *([overflow_sentence(tracing.overflows)] if tracing.overflows else []),
        ]
        declared = [replace(item, after=item.before) for item in d.fitted]
        open_channels = _channels([test for test in d.tests_before if not test.passed])
        return [
            *sentences,
            *(
                f"with the declared model, {line}"
                for line in _left(tracing, declared, open_channels)
            ),
        ]
    cautions = [caution for caution in d.warnings if caution.test is not None]
    failed = [caution.test for caution in cautions if caution.test is not None]
    lines = cautions if len(failed) > FEW_PARAMETERS else []
    sentences = [caution.sentence for caution in d.warnings if caution not in lines]
    sentences += [overflow_sentence(tracing.overflows)] if tracing.overflows else []
    if failed:
        share = (
            [
                f"{len(failed)} of {len(d.tests_after)} tests for whiteness fail in "
                f"{', '.join(_channels(failed))}"
            ]
            if lines
            else []
        )
        return [*sentences, *share, *_left(tracing, d.fitted, _channels(failed))]
    return sentences


def _channels(tests: Sequence[ResidualTest]) -> list[str]:
    return list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))


def _left(tracing: Tracing, fitted: Sequence[FittedRecord], channels: Sequence[str]) -> list[str]:
    found = [left_over(fitted, channel) for channel in channels]
    return [leftover_sentence(item, tracing) for item in found if item is not None]


def leftover_sentence(left: Leftover, tracing: Tracing) -> str:
    """Return a sentence on the residual of one channel: size, colour, frequency, time, and
    correlated signals.
    """
    factor, unit = shown_in(left.unit, left.channel)
    parts = [
        f"left in the {_spoken(left.channel, tracing)}: rms {factor * left.rms:.3g}{spaced(unit)}, "
        f"neighbouring samples correlated by {left.correlation:.2f}",
        f"most power near {left.peak:.2g} Hz, four fifths of it below {left.below:.2g} Hz",
    ]
    if left.times > LARGEST_EVEN_PEAK:
        record = tracing.diagnosis.fitted[left.record].record.name
        parts.append(
            f"largest in {record} from {left.begin:.1f} to {left.end:.1f} s, {left.times:.1f} "
            "times its rms"
        )
    else:
        parts.append("about alike everywhere")
    if left.company is None:
        return "; ".join(
            [*parts, "goes with no input and no channel, nor their rates, squares and products"]
        )
    company = left.company
    control = next(iter(tracing.records[0].input_names), "input")
    what = FORMS[company.form].format(f"the {_spoken(company.name, tracing)}", control=control)
    later = (
        f", {abs(company.later):.2g} s {'later' if company.later > 0 else 'earlier'}"
        if abs(company.later) > 1e-9
        else ""
    )
    return "; ".join([*parts, f"goes with {what} (correlation {company.correlation:+.2f}{later})"])


def scatter_text(d: Diagnosis, name: str) -> str:
    """``" (run-to-run scatter 0.8)"`` after a derivative, empty if it is not known."""
    return f" (run-to-run scatter {d.scatter[name]:.2g})" if name in d.scatter else ""


def _spoken(name: str, tracing: Tracing) -> str:
    return CHANNELS.get(name, name.replace("_", " ")) if is_of_aircraft(tracing.model) else name


def _unit(quantity: Quantity) -> str:
    return quantity.unit if quantity.unit != "1" else ""
