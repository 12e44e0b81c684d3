"""The fit in per cent of a predicted record, from signals to the number."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ident.statistics.residuals import error_figures
from scenarios.tolerances import sensor_noise_of
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


@pytest.mark.parametrize(
    ("name", "content", "noise"),
    [
        ("comparison.json", {"sensor_noise": {"q": 0.002, "nz": None}}, {"q": 0.002}),
        ("diagnosis.json", {"error": {"noise_floor": {"q": 0.003}}}, {"q": 0.003}),
        ("comparison.json", {"noise_std": {"q": 0.002}}, {}),
        ("diagnosis.json", {"error": None}, {}),
    ],
)
def test_the_sensor_noise_of_a_study(
    tmp_path: Path, name: str, content: object, noise: dict[str, float]
) -> None:
    (tmp_path / name).write_text(json.dumps(content))
    assert sensor_noise_of(tmp_path) == noise
