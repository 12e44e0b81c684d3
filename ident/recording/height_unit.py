"""A height that is not in metres: under gravity and drag alone a falling body shows the unit by its own acceleration."""

from __future__ import annotations

import math

import numpy as np

from ident.recording.finding import Certainty, Expectations, Finding, Kind, Number
from ident.recording.series import FEWEST
from sim.record import Channel, Record

HEIGHT = "altitude"
LENGTHS = {"ft": 0.3048, "km": 1000.0, "cm": 0.01, "mm": 0.001}
CLEARLY = 16.0  # times less power than in metres, and than in any other unit: four times the amplitude
RIGHT = 0.01  # share of the power about a straight line that the right unit leaves; noise and drag that varies leave less
SMOOTH = 40  # a velocity is the slope over two fortieths of the record


def height_unit(record: Record, expected: Expectations) -> list[Finding]:
    """A finding where a height that falls under ``expected.gravity`` obeys it in another unit than metres, and not in metres.

    Of h(t) in a unit of f metres, f h = c0 + c1 t - g t^2/2 + k D(t), where D is the double integral of -v |v| exp(-f h/H), v = f dh/dt,
    and the drag k is not negative. Near the terminal speed every unit fits as well as another, and nothing is found.
    """
    if expected.scale_height is None or HEIGHT not in record.output_names:
        return []
    channel = record[HEIGHT]
    if np.count_nonzero(channel.valid) < 2 * FEWEST:
        return []
    as_read = _unexplained(record.time, channel, 1.0, expected)
    found = sorted((_unexplained(record.time, channel, factor, expected), unit) for unit, factor in LENGTHS.items())
    (best, unit), (second, _) = found[:2]
    if best > RIGHT or CLEARLY * best > min(as_read, second):
        return []
    told = f"is in {unit}, not in m: it falls under gravity as heights in {unit} do (unexplained {100.0 * best:.2g} % of the motion)"
    told += f", not as heights in m ({100.0 * as_read:.2g} %)"
    numbers = {"unexplained": Number(as_read, "1"), "unexplained_otherwise": Number(best, "1")}
    remedy = f"name the column {HEIGHT} [{unit}], or say its unit in a channel map"
    return [Finding(HEIGHT, Kind.UNIT, Certainty.CERTAIN, told, remedy, numbers=numbers)]


def _unexplained(time: np.ndarray, channel: Channel, factor: float, expected: Expectations) -> float:
    """Share of a height's power about a straight line that gravity and drag leave, were its unit ``factor`` metres."""
    t, y = time[channel.valid] - time[channel.valid][0], factor * channel.values[channel.valid]
    velocity = _slope(t, y)
    with np.errstate(over="ignore", under="ignore"):
        density = np.exp(-np.clip((y - y[0]) / (expected.scale_height or math.inf), -50.0, 50.0))
    drag = _integral(t, _integral(t, -velocity * np.abs(velocity) * density))
    line = np.stack([np.ones(len(t)), t / t[-1]], axis=1)
    rest = _off(line, y + 0.5 * expected.gravity * t**2)
    along = _off(line, drag)
    power = float(along @ along)
    if power > 0.0:
        rest = rest - max(float(rest @ along) / power, 0.0) * along
    about = _off(line, y)
    total = float(about @ about)
    return float(rest @ rest) / total if total > 0.0 else math.inf


def _off(line: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.asarray(values - line @ np.linalg.lstsq(line, values, rcond=None)[0])


def _slope(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slope of a line through the samples within a fortieth of the record on either side, by running sums."""
    reach = max(2, len(t) // SMOOTH)
    low, high = np.maximum(np.arange(len(t)) - reach, 0), np.minimum(np.arange(len(t)) + reach + 1, len(t))
    y = y - y[0]
    sums = [np.concatenate([[0.0], np.cumsum(each)]) for each in (t, y, t * t, t * y)]
    st, sy, stt, sty = (each[high] - each[low] for each in sums)
    count = high - low
    return np.asarray((count * sty - st * sy) / (count * stt - st * st))


def _integral(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
