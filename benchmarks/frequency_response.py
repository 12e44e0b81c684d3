"""Frequency response of ten minutes at 400 Hz, one input and one output, against scipy.signal.csd
and the Markov parameters of python-control, all in one run.

Each way is timed in CPU seconds and judged by the median error of the response against the truth
between 0.1 and 5 Hz. Run as ``python benchmarks/frequency_response.py``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import control
import numpy as np
from scipy import signal

from ident.frequency_response import EvenSignals, Spectra, estimate_responses
from ident.frequency_response.estimate import decimated, frequencies, window_lengths

RATE, DURATION = 400.0, 600.0
REPEATS = 3
LATEST = 5.0  # s of the impulse response that python-control estimates


def record() -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Input, output with noise, and the discrete system between them: a short period."""
    rng = np.random.default_rng(1)
    count = int(RATE * DURATION)
    x = signal.lfilter(*signal.butter(2, 12.0 / RATE), rng.standard_normal(count))
    top, bottom, _ = signal.cont2discrete(([6.0, 7.2], [1.0, 3.2, 16.0]), 1.0 / RATE, "zoh")
    system = np.ravel(top), bottom
    y = signal.lfilter(*system, x)
    return x, y + 0.2 * y.std() * rng.standard_normal(count), system


def composite(x: np.ndarray, y: np.ndarray, high: float) -> tuple[np.ndarray, np.ndarray]:
    """flightid's estimate up to ``high``, Hz: frequencies and response."""
    records, _ = decimated([EvenSignals(1.0 / RATE, x[None], y[None])], high)
    windows = window_lengths([DURATION])
    at = frequencies(2.0 / windows[0], high)
    return at, estimate_responses(records, at, Spectra(windows)).response[0, 0]


def welch(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One window length with scipy, without errors."""
    options = {"fs": RATE, "nperseg": int(30.0 * RATE), "noverlap": int(22.5 * RATE)}
    at, cross = signal.csd(x, y, **options)
    signal.welch(y, **options)  # for the coherence
    return at, cross / signal.welch(x, **options)[1]


def markov(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The transform of the Markov parameters that python-control estimates, at an eighth of the
    rate.
    """
    few, step = 8, 8.0 / RATE
    u, z = (signal.resample_poly(each, 1, few) for each in (x, y))
    h = np.ravel(control.markov(z, u, round(LATEST / step), dt=True))
    at = np.geomspace(0.1, 5.0, 116)
    return at, np.exp(-2j * math.pi * np.outer(at, step * np.arange(h.size))) @ h


def main() -> None:
    """Print a row for each way."""
    x, y, (top, bottom) = record()
    ways: dict[str, Callable[[], tuple[np.ndarray, np.ndarray]]] = {
        "flightid, to 10 Hz": lambda: composite(x, y, 10.0),
        "flightid, to 80 Hz": lambda: composite(x, y, 80.0),
        "scipy.signal.csd": lambda: welch(x, y),
        "control.markov": lambda: markov(x, y),
    }
    print(f"{'way':20}{'CPU s':>8}{'ratio':>8}{'median error':>14}")
    first = 0.0
    for name, way in ways.items():
        spent = []
        for _ in range(REPEATS):
            begun = time.process_time()
            at, found = way()
            spent.append(time.process_time() - begun)
        first = first or min(spent)
        z = np.exp(2j * math.pi * at / RATE)
        error = np.abs(found / (np.polyval(top, z) / np.polyval(bottom, z)) - 1.0)
        inside = (at >= 0.1) & (at <= 5.0)
        print(
            f"{name:20}{min(spent):8.2f}{min(spent) / first:8.1f}{np.median(error[inside]):14.4f}"
        )


if __name__ == "__main__":
    main()
