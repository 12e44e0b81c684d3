"""Morelli's example of real-time estimation rebuilt: the F-16's short period, stable and unstable.

E. A. Morelli, program `rtpid_demo`, 15 December 1999: linear dynamics of the F-16 sampled at 50 Hz
for 20 s, noise of 0.1 deg and 0.1 deg/s, equation error on recursive Fourier transforms at 0.1 to
1.5 Hz every second. A person moves the elevator there; here a multisine of 1 deg does. The method
as it is published (Journal of Guidance, Control, and Dynamics 23(5), 2000) is written a second
time below.
"""

from __future__ import annotations

import numpy as np
import pytest

from exam.coverage.streams import stream
from ident.frequency_domain.online import frequencies
from scenarios.watching.spectral import regress, spectral_session, take

BAND = frequencies(0.1, 1.5, 0.04)
NAMES = ("Z_alpha", "Z_q", "Z_de", "M_alpha", "M_q", "M_de")


def as_published(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors: j omega X regressed on X and U, equation by equation."""
    time, elevator, alpha, q = rows
    turn = np.exp(-1j * np.outer(BAND, time))
    x, y, u = (turn @ each for each in (alpha, q, elevator))
    regressors = np.stack([x, y, u], axis=1)
    inverse = np.linalg.inv(np.real(regressors.conj().T @ regressors))
    values, errors = [], []
    for each in (x, y):
        left = 1j * BAND * each
        found = inverse @ np.real(regressors.conj().T @ left)
        power = np.sum(np.abs(left - regressors @ found) ** 2) / (BAND.size - 3)
        values += found.tolist()
        errors += np.sqrt(power * np.diag(inverse)).tolist()
    return np.array(values), np.array(errors)


@pytest.mark.parametrize("case", ["f16", "f16-unstable"])
def test_the_example_of_real_time_estimation(case: str) -> None:
    ours, published, held = [], [], []
    for seed in range(3):
        vehicle, rows, true = stream(case, seed)
        exact = np.array([true[name] for name in NAMES])
        session = spectral_session(vehicle, "stream", ("alpha", "q"), BAND)
        take(session, rows)
        regress(session)
        assert session.names == NAMES and len(session.points) >= 18  # one a second
        last = session.points[-1]
        held += (np.abs(last.values - exact) <= 1.96 * last.std).tolist()
        assert np.all(np.abs(last.values - exact) < 4.0 * last.std)
        # An estimate for every second, the sharper the longer the stream.
        early = session.points[4].std
        assert np.all(last.std < early) and np.mean(last.std / early) < 0.75
        ours.append(np.abs(last.values - exact))
        values, errors = as_published(rows)
        published.append(np.abs(values - exact))
        # The published form, begun at rest, ends at the same numbers to within its errors.
        assert np.all(np.abs(values - last.values) < 5.0 * np.hypot(errors, last.std))
    assert np.mean(held) >= 15 / 18
    # Increments in place of j omega X: neither the end of the motion nor the sampling costs.
    assert np.mean(ours) < np.mean(published)
