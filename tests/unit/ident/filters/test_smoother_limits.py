"""The smoother's variances where rounding or a history that contradicts itself would leave their
range.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import FilterHistory
from ident.filters.ekf import FilterSettings, run_ekf
from ident.filters.one_record import Taylor
from ident.filters.smoother import smooth
from sim.declaration.compile import compile_model
from tests.linear_problem import oscillator, record_of


def history(rng: int = 4) -> FilterHistory:
    estimate = run_ekf(
        record_of(np.random.default_rng(rng), 20),
        compile_model(oscillator({"speed": 0.05}), online=True),
        FilterSettings(transition=Taylor(5)),
    )
    assert estimate.history is not None
    return estimate.history


def correlations(P: np.ndarray) -> np.ndarray:
    std = np.sqrt(np.diag(P))
    return np.asarray(P / np.outer(std, std))


def test_a_smoothed_variance_is_never_above_the_filters() -> None:
    """An innovation covariance of the wrong sign makes W negative and P - P W P larger than P."""
    kept = history()
    wrong = kept.innovation_covariance.copy()
    wrong[-1] = -wrong[-1]
    smoothed = smooth(replace(kept, innovation_covariance=wrong))
    np.testing.assert_array_equal(smoothed.covariance[-1], kept.covariance[-1])
    k = len(kept.time) - 2
    # By hand, over the last sample only: W = (Phi - K H Phi)' ... with S negative.
    H, S, G = kept.sensitivity[-1], wrong[-1], kept.transition[-1]
    W = G.T @ H.T @ np.linalg.solve(S, H) @ G
    P = kept.covariance[k]
    reduced = P - P @ W @ P
    above = np.diag(reduced) > np.diag(P)
    assert np.any(above)
    got = smoothed.covariance[k]
    np.testing.assert_allclose(np.diag(got), np.minimum(np.diag(reduced), np.diag(P)), rtol=1e-10)
    np.testing.assert_allclose(correlations(got), correlations(reduced), rtol=1e-8, atol=1e-10)
    assert np.all(smoothed.std <= kept.std * (1.0 + 1e-12))


def test_a_negative_variance_becomes_zero_with_its_row_and_column() -> None:
    """An innovation covariance that is far too small takes more variance away than there is."""
    kept = history()
    wrong = kept.innovation_covariance.copy()
    wrong[-1] *= 0.05
    k = len(kept.time) - 2
    H, G, P = kept.sensitivity[-1], kept.transition[-1], kept.covariance[k]
    reduced = P - P @ G.T @ H.T @ np.linalg.solve(wrong[-1], H) @ G @ P
    negative = np.diag(reduced) < 0.0
    assert np.any(negative)
    smoothed = smooth(replace(kept, innovation_covariance=wrong))
    got = smoothed.covariance[k]
    assert np.all(np.diag(got) >= 0.0) and np.all(np.isfinite(smoothed.std))
    np.testing.assert_array_equal(got[negative], 0.0)
    np.testing.assert_array_equal(got[:, negative], 0.0)
    np.testing.assert_allclose(np.diag(got)[~negative], np.diag(reduced)[~negative], rtol=1e-10)


def test_where_numbers_leave_their_range_the_filters_stay() -> None:
    kept = history()
    wild = kept.transition.copy()
    wild[10] = 1e200
    smoothed = smooth(replace(kept, transition=wild))
    np.testing.assert_array_equal(smoothed.mean[:, :9], kept.mean[:, :9])
    np.testing.assert_array_equal(smoothed.covariance[:9], kept.covariance[:9])
    assert np.all(np.isfinite(smoothed.std)) and smoothed.std[0, 15] == pytest.approx(
        smooth(kept).std[0, 15], rel=1e-12
    )
