"""Hum: a narrow line above the motion whose amplitude and phase stay, also while the aircraft rests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number, shown
from ident.recording.series import Series

LOWEST = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below
EVEN = 0.02  # of the usual step, within which steps are even
FEWEST, LONGEST = 128, 20_000  # samples that are needed, and looked at
AROUND, BESIDE = 24, 3  # frequencies whose median is the floor, and those next to a line that belong to it
# Power over the floor's mean is exponentially distributed under noise: ln(number of frequencies/chance), a third more for the floor's own scatter.
CHANCE, MARGIN = 1e-5, 1.35
PARTS, MOST_PARTS = 6, 16  # a strong line is looked at in finer parts, so that ringing after each step shows
FINER = 80.0  # of N (amplitude/noise)^2 for a part: its amplitude is then known to a seventh
COHERENT = 0.85  # share of the parts' power that their sum keeps: 1 for one phase and amplitude, 1/6 for noise
STEADY = 2.5  # ratio of the largest to the smallest amplitude of 16 parts: 1.8 by noise at most once in a hundred hums
MATTERS = 0.3  # of the channel's noise, below which a line changes no estimate
OF_BIT = 0.5  # of the least bit: rounding of a periodic motion makes lines below that
IN_INPUT = 1e-4  # of an input's span, from which a line of one phase in it may be what the output answers to


def hum(series: Series, inputs: Sequence[Series]) -> Finding | None:
    """A warning of a line above the motion: frequency, amplitude. Structure rings down and follows its excitation; a hum does neither."""
    series = replace(series, time=series.time[:LONGEST], values=series.values[:LONGEST])
    step = np.diff(series.time)
    usual = float(np.median(step)) if step.size else 0.0
    n = len(series.values)
    if n < FEWEST or np.max(np.abs(step - usual)) > EVEN * usual or 0.5 / usual <= LOWEST:
        return None
    # Differences take the motion down, which falls with frequency; what they do to a line is undone below.
    bent = np.diff(series.values, 2)
    window = np.hanning(len(bent) + 2)[1:-1]
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent)))) ** 2
    frequency = np.fft.rfftfreq(len(bent), usual)
    first = int(np.searchsorted(frequency, LOWEST))
    ratio = _over_floor(power / np.maximum(2.0 * np.sin(math.pi * frequency * usual), 1e-3) ** 4, first)
    if not ratio.size:
        return None
    peak = first + int(np.argmax(ratio))
    if ratio[peak - first] < MARGIN * math.log(len(ratio) / CHANCE):
        return None
    at = _refined(bent, usual, float(frequency[peak]), float(frequency[1]))
    amplitude = float(abs(np.mean(_parts(bent, usual, at, PARTS))))
    finer = n * (amplitude / max(series.noise, 1e-6 * amplitude)) ** 2 / FINER
    parts = _parts(bent, usual, at, int(np.clip(min(finer, at * n * usual / 4.0), PARTS, MOST_PARTS)))
    sizes = np.abs(parts)
    if _coherence(parts) < COHERENT or np.max(sizes) > STEADY * np.min(sizes) or amplitude < max(MATTERS * series.noise, OF_BIT * series.least_bit):
        return None
    if any(_in_input(other, at) for other in inputs):
        return None
    told = f"hums at {at:.4g} Hz with an amplitude of {shown(amplitude, series.unit)}, the same in phase and size throughout"
    told += f"; a hum above {0.5 / usual:.3g} Hz, half the sample rate, shows as a lower frequency"
    numbers = {"frequency": Number(at, "Hz"), "amplitude": Number(amplitude, series.unit)}
    remedy = "filter all channels alike with --lowpass below it, or mend the wiring; mains is at 50 or 60 Hz, aircraft supply at 400 Hz"
    return Finding(series.name, Kind.HUM, Certainty.LIKELY, told, remedy, (), numbers)


def _over_floor(power: np.ndarray, first: int) -> np.ndarray:
    """Each frequency's power over the mean of its neighbours', from their median; from ``first`` on, the last left out."""
    some = power[first:-1]
    if len(some) < AROUND:
        return np.zeros(0)
    padded = np.pad(some, AROUND, mode="reflect" if len(some) > AROUND else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    beside = np.delete(windows, np.s_[AROUND - BESIDE : AROUND + BESIDE + 1], axis=1)
    floor = np.median(beside, axis=1) / math.log(2.0)
    return np.asarray(some / np.maximum(floor, 1e-300))


def _refined(bent: np.ndarray, step: float, near: float, apart: float) -> float:
    """The line's frequency between two bins, Hz."""
    number = np.arange(len(bent))
    window = np.hanning(len(bent) + 2)[1:-1]
    grid = near + apart * np.linspace(-1.0, 1.0, 41)
    turn = np.exp(-2j * math.pi * step * grid[:, None] * number[None, :])
    return float(grid[int(np.argmax(np.abs(turn @ (window * bent))))])


def _parts(bent: np.ndarray, step: float, at: float, count: int) -> np.ndarray:
    """The line's complex amplitude in each part of the record, of the channel itself whose second differences are ``bent``."""
    number = np.arange(len(bent))
    turned = bent * np.exp(-2j * math.pi * at * step * number)
    gain = (2.0 * math.sin(math.pi * at * step)) ** 2
    parts = []
    for rows in np.array_split(number, count):
        weights = np.hanning(len(rows) + 2)[1:-1]
        parts.append(2.0 * complex(np.sum(weights * turned[rows]) / np.sum(weights)) / gain)
    return np.array(parts)


def _coherence(parts: np.ndarray) -> float:
    power = float(np.mean(np.abs(parts) ** 2))
    return float(abs(np.mean(parts)) ** 2) / power if power > 0.0 else 0.0


def _in_input(other: Series, at: float) -> bool:
    """Whether an input has the line itself, one phase throughout, as a periodic one has at its harmonics; at its own sample rate."""
    step = float(np.median(np.diff(other.time)))
    parts = _parts(np.diff(other.values[:LONGEST], 2), step, at, PARTS)
    return abs(np.mean(parts)) > IN_INPUT * other.span and _coherence(parts) > 0.5
