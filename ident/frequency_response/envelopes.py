"""Envelopes of added dynamics that pilots do not notice, for equivalent systems."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Envelopes:
    """Envelopes of maximum unnoticeable added dynamics, ``(F,)`` each, in dB and deg."""

    low_gain: np.ndarray
    high_gain: np.ndarray
    low_phase: np.ndarray
    high_phase: np.ndarray


PILOT_BAND = (0.1, 10.0)  # rad/s, frequencies of a pilot's control, at which the envelopes apply
# Numerator and denominator in s, highest power first, of the lower and upper curve, by Hodgkinson
# and Wood (McDonnell Douglas), as in MIL-STD-1797A. Some prints also have short delays in the phase
# curves, which widen the envelope by up to 4 deg at 10 rad/s.
_GAINS = (([0.0955, 9.92, 2.15], [1.0, 11.60, 4.95]), ([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]))
_PHASES = (
    ([475.32, 184100.0, 29460.0], [1.0, 11.66, 0.0389]),
    ([68.89, 1100.12, -275.22], [1.0, 39.94, 9.99]),
)


def unnoticeable_envelopes(omega: np.ndarray) -> Envelopes:
    """Return the envelopes of added dynamics that pilots do not notice, at ``omega``, rad/s.

    Wood and Hodgkinson, "Definition of Acceptable Levels of Mismatch for Equivalent Systems of
    Augmented CTOL Aircraft", MDC A6792, McDonnell Douglas 1980; MIL-STD-1797A.
    """
    s = 1j * np.asarray(omega)

    def curve(numerator: list[float], denominator: list[float]) -> np.ndarray:
        return np.asarray(np.polyval(numerator, s) / np.polyval(denominator, s))

    gains = [20.0 * np.log10(np.abs(curve(*polynomials))) for polynomials in _GAINS]
    phases = [np.degrees(np.angle(curve(*polynomials))) for polynomials in _PHASES]
    return Envelopes(gains[0], gains[1], phases[0], phases[1])
