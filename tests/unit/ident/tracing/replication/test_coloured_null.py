"""The colour of residuals: innovations of known autoregressions."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.replication.coloured_null import innovation_level


def autoregression(coefficients: tuple[float, ...], std: float, n: int = 6000, seed: int = 1) -> np.ndarray:
    """x[k] = sum_i a_i x[k - i] + e[k], written out; its beginning left out."""
    rng = np.random.default_rng(seed)
    x = np.zeros(n + 500)
    for k in range(len(coefficients), len(x)):
        x[k] = sum(a * x[k - i] for i, a in enumerate(coefficients, start=1)) + std * rng.standard_normal()
    return x[500:]


@pytest.mark.parametrize("coefficients", [(), (0.9,), (1.6, -0.8), (0.5, 0.2, -0.4)])
def test_innovations_of_an_autoregression_are_what_drives_it(coefficients: tuple[float, ...]) -> None:
    series = autoregression(coefficients, 0.3)
    level = innovation_level(series, np.ones(len(series), dtype=bool))
    assert level == pytest.approx(2.0 * np.log(0.3), abs=0.06)


def test_missing_samples_and_silence_do_no_harm() -> None:
    series, rng = autoregression((0.9,), 1.0), np.random.default_rng(2)
    valid = rng.random(len(series)) > 0.05
    assert np.isfinite(innovation_level(np.where(valid, series, 1e9), valid))
    assert np.isfinite(innovation_level(np.zeros(100), np.ones(100, dtype=bool)))


def test_the_order_is_paid_for() -> None:
    """White noise asks for none and is its own innovation; one order costs ln(n)/n a sample."""
    white = autoregression((), 0.3)
    everywhere = np.ones(len(white), dtype=bool)
    assert innovation_level(white, everywhere) == pytest.approx(np.log(np.var(white)), abs=1e-12)
    series = autoregression((0.9,), 0.3)
    centred = series - series.mean()
    reflection = (centred[1:] @ centred[:-1]) / (centred @ centred)
    expected = np.log(np.var(series) * (1.0 - reflection**2)) + np.log(len(series)) / len(series)
    assert innovation_level(series, everywhere) == pytest.approx(expected, abs=1e-12)
