"""Frequency responses that a designed maneuver would give: coherence and random error, before
flight.

The maneuver as the model flies it, with drawn sensor noise, goes through the estimate of
``flightid response``; what it says is averaged over the draws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.frequency_response import LEAST_COHERENCE, Signals, Spectra, estimate_responses
from ident.frequency_response.estimate import (
    decimated,
    frequencies,
    lowest_frequency,
    window_lengths,
)
from scenarios.maneuver_design.setting import Setting
from scenarios.maneuver_design.within_limits import LimitedManeuver

DRAWS = 8  # of the noise
NEED = 0.5  # random error from which a response says nothing


@dataclass(frozen=True, eq=False)
class Predicted:
    """Responses of m outputs to q inputs at F frequencies, expected of one flight.

    Attributes
    ----------
    frequency : Hz, ``(F,)``. inputs, outputs : names.
    coherence : ``(m, q, F)``, partial where there are several inputs, mean over draws.
    random_error : ``(m, q, F)``, of the magnitude, median over draws.
    usable : ``(m, q)``, share of the band, in its logarithm, with a coherence of 0.6 or more.
    """

    frequency: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    coherence: np.ndarray
    random_error: np.ndarray

    @property
    def usable(self) -> np.ndarray:
        """Share of the frequencies, evenly spaced in their logarithm, that would be usable."""
        return np.asarray(np.mean(self.coherence >= LEAST_COHERENCE, axis=2))

    @property
    def criterion(self) -> float:
        """Geometric mean of the random errors, each 50 % at most: the lower, the better."""
        return float(np.exp(np.mean(np.log(np.minimum(self.random_error, NEED)))))


def predicted_responses(setting: Setting, flight: LimitedManeuver) -> Predicted:
    """The responses that a flight of a maneuver over the setting's band would give."""
    assert setting.room.band is not None
    low, high = (omega / (2.0 * math.pi) for omega in setting.room.band)
    names = tuple(flight.motion.system.output_names)
    clean = np.array(flight.motion.fit.lines[0].y)
    duration = clean.shape[1] * setting.room.interval
    windows = window_lengths([duration], low)
    low = max(low, lowest_frequency(windows))
    at = frequencies(low, high)
    noise = np.array([setting.noise[name] for name in names])[:, None]
    rng = np.random.default_rng(1)
    coherence, errors = [], []
    for _ in range(DRAWS):
        measured = clean + noise * rng.standard_normal(clean.shape)
        records, _ = decimated([Signals(setting.room.interval, flight.rows, measured)], high)
        found = estimate_responses(records, at, Spectra(windows))
        coherence.append(found.partial_coherence)
        errors.append(found.random_error)
    inputs = tuple(setting.rest)
    return Predicted(at, inputs, names, np.mean(coherence, axis=0), np.median(errors, axis=0))
