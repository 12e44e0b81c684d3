"""The fit in per cent of a predicted record, from signals to the number."""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.residuals import error_figures
from sim.record import Channel, Record

Z = np.sin(np.linspace(0.0, 20.0, 400)) + 0.3


@pytest.mark.parametrize(
    ("predicted", "percent"),
    [
        (Z, 100.0),
        (np.full(400, Z.mean()), 0.0),  # no better than the mean
        (Z.mean() + 0.5 * (Z - Z.mean()), 50.0),
        (Z.mean() - (Z - Z.mean()), -100.0),
    ],
)
def test_the_fit_is_one_less_the_error_over_the_spread(
    predicted: np.ndarray, percent: float
) -> None:
    record = Record(np.arange(400) * 0.05, (), (Channel.of("q", "rad/s", Z),))
    figures = error_figures([predicted[None]], [record], [np.ones((1, 400), dtype=bool)], ["q"])
    assert figures.fit_percent("q") == pytest.approx(percent, abs=1e-9)
