"""Record check: search for faults in the raw columns. Hum and filtered channels are found here,
from the spectrum of a channel.

Filtered channels: the white noise of a sensor fills the spectrum up to half the sample rate, and so
does the rounding of a converter that follows an analogue filter. A channel whose spectrum is flat
up to a cutoff and empty above it was therefore filtered after the conversion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtri

from ident.recording.distorted_channels import (
    clipping_findings,
    interpolation_finding,
    zero_step_findings,
)
from ident.recording.kinematic_relations import height_unit_findings
from ident.recording.misread_columns import misread_findings
from ident.recording.missing_samples import (
    dropout_findings,
    held_samples_finding,
    missing_rows_findings,
    stuck_finding,
)
from ident.recording.series import (
    FEWEST_SAMPLES,
    Certainty,
    Expectations,
    Kind,
    RecordFinding,
    Series,
    noise_level_finding,
    quantities,
    quantity_text,
    resolution_finding,
    series_of,
)
from sim.record import Record

# ---- Hum

LOWEST_HUM = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below
EVEN_TOLERANCE = 0.02  # largest relative deviation of a step from the usual one
FEWEST_HUM_SAMPLES = 128
MOST_SAMPLES = 20_000  # most samples that are used
FLOOR_BINS = 24  # frequencies on either side of a line whose median is the noise floor
LINE_BINS = 3  # frequencies on either side that belong to a line
HUM_CHANCE = 1e-5  # probability of a false line
# The power of noise is exponential: the threshold over the noise floor is ln(frequencies/chance),
# times this factor for the scatter of the floor.
FLOOR_SCATTER_FACTOR = 1.35
FEWEST_PARTS = 6  # fewest parts of a record in which the amplitude of a line is compared
MOST_PARTS = 16  # most parts, for a strong line: they show that ringing after steps decays
FEWEST_PERIODS_PER_PART = 4.0
# N (amplitude/noise)^2 of a part that gives the amplitude with a standard deviation of one seventh
INFORMATION_PER_PART = 80.0
# smallest power of the mean amplitude over the mean power: 1 for a constant phase, 1/6 for noise
LEAST_COHERENT_SHARE = 0.85
# largest ratio of the amplitudes of 16 parts: noise gives 1.8 in one of a hundred hums
LARGEST_AMPLITUDE_RATIO = 2.5
HUM_TO_NOISE = 0.3  # smallest amplitude over the noise: a smaller hum changes no estimate
# smallest amplitude over the least bit: rounding of a periodic motion makes smaller lines
HUM_TO_BIT = 0.5
# smallest amplitude of a line in an input to which the output may respond, as a share of its span
INPUT_LINE_SHARE = 1e-4
LEAST_INPUT_COHERENCE = 0.5  # smallest coherence of such a line


def hum_finding(series: Series, inputs: Sequence[Series]) -> RecordFinding | None:
    """Return a warning if the spectrum has a line above the frequencies of the motion; else None.

    A structural mode is not taken for a hum: its motion decays after an excitation, while a hum
    keeps its amplitude and phase over the record.
    """
    series = replace(series, time=series.time[:MOST_SAMPLES], values=series.values[:MOST_SAMPLES])
    steps = np.diff(series.time)
    step = float(np.median(steps)) if steps.size else 0.0
    n = len(series.values)
    if (
        n < FEWEST_HUM_SAMPLES
        or np.max(np.abs(steps - step)) > EVEN_TOLERANCE * step
        or 0.5 / step <= LOWEST_HUM
    ):
        return None
    # Second differences suppress the motion at low frequencies; their gain is removed below.
    bends = np.diff(series.values, 2)
    window = np.hanning(len(bends) + 2)[1:-1]
    power = np.abs(np.fft.rfft(window * (bends - np.mean(bends)))) ** 2
    frequency = np.fft.rfftfreq(len(bends), step)
    first = int(np.searchsorted(frequency, LOWEST_HUM))
    ratio = _power_over_floor(
        power / np.maximum(2.0 * np.sin(math.pi * frequency * step), 1e-3) ** 4, first
    )
    if not ratio.size:
        return None
    peak = first + int(np.argmax(ratio))
    if ratio[peak - first] < FLOOR_SCATTER_FACTOR * math.log(len(ratio) / HUM_CHANCE):
        return None
    line_frequency = _refine_frequency(bends, step, float(frequency[peak]), float(frequency[1]))
    amplitude = float(abs(np.mean(_amplitudes(bends, step, line_frequency, FEWEST_PARTS))))
    by_noise = n * (amplitude / max(series.noise, 1e-6 * amplitude)) ** 2 / INFORMATION_PER_PART
    by_periods = line_frequency * n * step / FEWEST_PERIODS_PER_PART
    count = int(np.clip(min(by_noise, by_periods), FEWEST_PARTS, MOST_PARTS))
    amplitudes = _amplitudes(bends, step, line_frequency, count)
    sizes = np.abs(amplitudes)
    if (
        _coherence(amplitudes) < LEAST_COHERENT_SHARE
        or np.max(sizes) > LARGEST_AMPLITUDE_RATIO * np.min(sizes)
        or amplitude < max(HUM_TO_NOISE * series.noise, HUM_TO_BIT * series.least_bit)
    ):
        return None
    if any(_has_line(control, line_frequency) for control in inputs):
        return None
    text = (
        f"hums at {line_frequency:.4g} Hz with an amplitude of "
        f"{quantity_text(amplitude, series.unit)}, constant in phase and amplitude; "
        f"a hum above {0.5 / step:.3g} Hz, half the sample rate, appears at a lower frequency"
    )
    numbers = quantities(frequency=(line_frequency, "Hz"), amplitude=(amplitude, series.unit))
    remedy = (
        "filter all channels alike with --lowpass below it, or repair the wiring; mains is at 50 "
        "or 60 Hz, aircraft supply at 400 Hz"
    )
    return RecordFinding(series.name, Kind.HUM, Certainty.LIKELY, text, remedy, (), numbers)


def _power_over_floor(power: np.ndarray, first: int) -> np.ndarray:
    """Return the ratio of the power to the noise floor at each frequency from position ``first`` to
    the last but one. The floor is the median power of the neighbouring frequencies over ln 2, since
    the power of noise has an exponential distribution.
    """
    above_lowest = power[first:-1]
    if len(above_lowest) < FLOOR_BINS:
        return np.zeros(0)
    padded = np.pad(
        above_lowest, FLOOR_BINS, mode="reflect" if len(above_lowest) > FLOOR_BINS else "edge"
    )
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * FLOOR_BINS + 1)
    neighbours = np.delete(
        windows, np.s_[FLOOR_BINS - LINE_BINS : FLOOR_BINS + LINE_BINS + 1], axis=1
    )
    floor = np.median(neighbours, axis=1) / math.log(2.0)
    return np.asarray(above_lowest / np.maximum(floor, 1e-300))


def _refine_frequency(bends: np.ndarray, step: float, near: float, spacing: float) -> float:
    """Return the frequency of the line, Hz, with a resolution of a twentieth of the ``spacing`` of
    frequencies, from second differences ``bends``. The search begins at ``near``, Hz.
    """
    number, window = np.arange(len(bends)), np.hanning(len(bends) + 2)[1:-1]
    grid = near + spacing * np.linspace(-1.0, 1.0, 41)
    harmonics = np.exp(-2j * math.pi * step * grid[:, None] * number[None, :])
    return float(grid[int(np.argmax(np.abs(harmonics @ (window * bends))))])


def _amplitudes(bends: np.ndarray, step: float, line_frequency: float, count: int) -> np.ndarray:
    """Return the complex amplitude of the line in each of ``count`` parts of a record, from the
    second differences ``bends (N - 2,)`` of the channel.
    """
    number = np.arange(len(bends))
    demodulated = bends * np.exp(-2j * math.pi * line_frequency * step * number)
    gain = (2.0 * math.sin(math.pi * line_frequency * step)) ** 2
    amplitudes = []
    for rows in np.array_split(number, count):
        weights = np.hanning(len(rows) + 2)[1:-1]
        mean = complex(np.sum(weights * demodulated[rows]) / np.sum(weights))
        amplitudes.append(2.0 * mean / gain)
    return np.array(amplitudes)


def _coherence(amplitudes: np.ndarray) -> float:
    """Return the power of the mean amplitude over the mean power of the amplitudes."""
    power = float(np.mean(np.abs(amplitudes) ** 2))
    return float(abs(np.mean(amplitudes)) ** 2) / power if power > 0.0 else 0.0


def _has_line(control: Series, line_frequency: float) -> bool:
    """Return whether an input has a line at this frequency, Hz, with a constant phase."""
    step = float(np.median(np.diff(control.time)))
    bends = np.diff(control.values[:MOST_SAMPLES], 2)
    amplitudes = _amplitudes(bends, step, line_frequency, FEWEST_PARTS)
    return (
        abs(np.mean(amplitudes)) > INPUT_LINE_SHARE * control.span
        and _coherence(amplitudes) > LEAST_INPUT_COHERENCE
    )


# ---- Channels whose noise ends at a frequency

FEWEST_SPECTRUM_SAMPLES = 256
BAND_COUNT = 40  # bands of equal width up to half the sample rate
# largest power above the cutoff over the power below it: noise amplitudes of one to a hundred
EMPTY_SHARE = 1e-4
# frequency over the cutoff from which the spectrum must be empty: the power of two-way Butterworth
# filters of order 4 has fallen to 1e-4 there
CUTOFF_WIDTH_RATIO = 1.8
FEWEST_FLAT_BANDS = 4  # fewest bands of noise of one level
FEWEST_EMPTY_BANDS = 4  # fewest bands without noise
BAND_LIMITED_CHANCE = 1e-3  # probability that a flat spectrum fails the test
# Blackman-Harris window: low side lobes, so that the empty bands show no power of the others
_WINDOW_COEFFICIENTS = (0.35875, -0.48829, 0.14128, -0.01168)
WINDOW_WIDENING = 2.0  # number of frequencies that one independent power of this window covers


def band_limit_finding(series: Series) -> RecordFinding | None:
    """Return a note if a channel has noise up to a cutoff frequency and none above; else None.

    Uneven or few samples, filters that are less steep, and motion that hides the noise give None.
    """
    time, values = series.time[:MOST_SAMPLES], series.values[:MOST_SAMPLES]
    steps = np.diff(time)
    step = float(np.median(steps)) if steps.size else 0.0
    if len(values) < FEWEST_SPECTRUM_SAMPLES:
        return None
    if np.max(np.abs(steps - step)) > EVEN_TOLERANCE * step:
        return None
    powers, frequencies_per_band = _band_powers(values), len(values) / 2.0 / BAND_COUNT
    for flat in range(BAND_COUNT - FEWEST_EMPTY_BANDS - 1, 2 * FEWEST_FLAT_BANDS - 1, -1):
        # The lower half of the bands below the cutoff may show motion.
        below = powers[flat // 2 : flat]
        first_empty = int(np.ceil(CUTOFF_WIDTH_RATIO * flat))
        above = powers[min(first_empty, BAND_COUNT - FEWEST_EMPTY_BANDS) :]
        if np.max(above) >= EMPTY_SHARE * np.median(below) or not _is_flat(
            below, 2.0 * frequencies_per_band / WINDOW_WIDENING
        ):
            continue
        share = flat / BAND_COUNT
        cutoff = 0.5 * share / step
        text = (
            f"has noise up to about {cutoff:.3g} Hz and none from there to {0.5 / step:.3g} Hz, "
            "half the sample rate: it was filtered or resampled before it was written, and one "
            f"sample in {1.0 / share:.2g} is independent"
        )
        remedy = (
            "export the channel as it was recorded; otherwise residuals are not white, and sigmas "
            "for white noise are too small"
        )
        numbers = quantities(cutoff=(cutoff, "Hz"))
        return RecordFinding(series.name, Kind.FILTERED, Certainty.NOTED, text, remedy, (), numbers)
    return None


def _band_powers(values: np.ndarray) -> np.ndarray:
    """Return the mean power of the values in each band, ``(BAND_COUNT,)``. It is computed from
    second differences, which suppress the motion, and divided by their gain.
    """
    bends = np.diff(values, 2)
    phase = 2.0 * np.pi * (np.arange(len(bends)) + 0.5) / len(bends)
    window = sum(a * np.cos(k * phase) for k, a in enumerate(_WINDOW_COEFFICIENTS))
    power = np.abs(np.fft.rfft(window * (bends - np.mean(bends))))[1:] ** 2
    share = np.arange(1, len(power) + 1) / len(power)
    power = power / (2.0 * np.sin(0.5 * np.pi * share)) ** 4
    band = np.minimum((BAND_COUNT * share).astype(int), BAND_COUNT - 1)
    return np.asarray(
        np.bincount(band, weights=power, minlength=BAND_COUNT)
        / np.bincount(band, minlength=BAND_COUNT)
    )


def _is_flat(powers: np.ndarray, freedom: float) -> bool:
    """Return whether noise is equal in both halves, and in first and last quarter (F tests)."""
    for count in (len(powers) // 2, max(len(powers) // 4, 1)):
        ratio = float(np.mean(powers[:count]) / np.mean(powers[-count:]))
        limit = fdtri(count * freedom, count * freedom, 1.0 - BAND_LIMITED_CHANCE)
        if max(ratio, 1.0 / ratio) > limit:
            return False
    return True


# ---- All searches in turn

LARGEST_MASKED_SHARE = 0.1  # a channel with more masked samples is not searched further
# order of the findings
ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : the record as it was read, in SI units and radians, with nz in g.
    expected : known values of the aircraft; None compares the channels only with each other.
    """
    expected = expected or Expectations()
    gravity_over_speed = expected.gravity / expected.airspeed if expected.airspeed else None
    outputs = [
        series_of(record, channel)
        for channel in record.outputs
        if np.count_nonzero(channel.valid) >= FEWEST_SAMPLES
    ]
    inputs = [series_of(record, channel) for channel in record.inputs]
    masked: dict[str, np.ndarray] = {}
    findings = missing_rows_findings(record) if len(record) >= FEWEST_SAMPLES else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        findings += _sample_findings(series, others, inputs, len(record), masked)
    for series in inputs:
        findings += [
            *dropout_findings(series, len(record), is_input=True),
            *clipping_findings(series, len(record), is_input=True),
        ]
        interpolation = interpolation_finding(series, len(record), is_input=True)
        findings += [interpolation] if interpolation is not None else []
    band_limits = [
        finding for series in inputs if (finding := band_limit_finding(series)) is not None
    ]
    findings += band_limits
    clean = _without_masked(record, masked)
    usable = [
        series_of(clean, clean[series.name])
        for series in outputs
        if not np.mean(masked[series.name]) > LARGEST_MASKED_SHARE
    ]
    for series in usable:
        others = [other for other in usable if other is not series]
        candidates = (
            resolution_finding(series),
            noise_level_finding(series, len(record), inputs, others),
            hum_finding(series, inputs),
            _output_band_limit_finding(series, band_limits),
        )
        findings += [finding for finding in candidates if finding is not None]
    findings += zero_step_findings(
        [series for series in usable if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        gravity_over_speed,
    )
    if expected.aircraft:
        findings += misread_findings(clean, expected)
    findings += height_unit_findings(clean, expected)
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.certainty)))


def _sample_findings(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings on wrong samples of one channel, and store the mask of these samples in
    ``masked``. No sample is in two findings. ``count`` is the number of rows of the record.
    """
    mask = np.zeros(count, dtype=bool)
    findings = dropout_findings(series, count)
    for finding in findings:
        mask |= finding.mask
    hold = held_samples_finding(series, count) if not findings else None
    interpolation = (
        interpolation_finding(series, count, inputs) if not findings and hold is None else None
    )
    lower_rate = hold or interpolation
    if lower_rate is not None:
        findings.append(lower_rate)
        mask |= lower_rate.mask
    else:
        for finding in clipping_findings(series, count):
            findings.append(finding)
            mask |= finding.mask
        stuck_samples = stuck_finding(series, others, inputs, count, mask)
        if stuck_samples is not None:
            findings.append(stuck_samples)
            mask |= stuck_samples.mask
    masked[series.name] = mask
    return findings


def _output_band_limit_finding(
    series: Series, input_findings: Sequence[RecordFinding]
) -> RecordFinding | None:
    """Return the finding of a band-limited output; None if an input has about the same cutoff,
    since a motion without noise has the bandwidth of its excitation.
    """
    finding = band_limit_finding(series)
    if finding is None:
        return None
    cutoff = finding.numbers["cutoff"].value
    if any(0.5 < other.numbers["cutoff"].value / cutoff < 2.0 for other in input_findings):
        return None
    return finding


def _without_masked(record: Record, masked: dict[str, np.ndarray]) -> Record:
    """Return the record with its masked samples invalid."""
    if not any(np.any(mask) for mask in masked.values()):
        return record
    outputs = tuple(
        replace(channel, valid=channel.valid & ~masked[channel.name])
        if np.any(masked.get(channel.name, False))
        else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)
