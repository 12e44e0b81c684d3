"""The start of a fit with process noise: as large as the residuals exceed the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from ident.process_noise.best_start import (
    _intensities,
    _intensity_factor,
    _with_positive_intensities,
    noise_start,
)
from ident.whole_record.gauss_newton import Fit, evaluate
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.record import Channel, Record
from tests.turbulence import rough_model

STEP, SAMPLES, DECAY, STD = 0.05, 200, 0.8, 0.07
FORCING = STD**2  # spectral density of the forcing


def decaying(factor: float = 1.0) -> Model:
    """x_dot = -0.8 x + w, of which an output reads ``factor`` times x."""
    model = own_model(
        "decay",
        states={"x": "m"},
        inputs={"push": "m/s"},
        outputs={"seen": "m"},
        parameters={"a": (DECAY, "1/s")},
        rates=lambda s, p: {"x": -p.a * s.x + s.push},
        readings=lambda s, p: {"seen": factor * s.x},
        biases=(),
    )
    return model.with_noise(Noise({"seen": 1.0}, {"x": FORCING}))


def fit_with(residual: float, factor: float = 1.0) -> Fit:
    """The declared model on a record that it misses by ``residual``, up and down in turn."""
    time = STEP * np.arange(SAMPLES)
    off = residual * (-1.0) ** np.arange(SAMPLES)
    push = Channel.of("push", "m/s", np.zeros(SAMPLES))
    record = Record(time, (push,), (Channel.of("seen", "m", off),))
    system = compile_model(decaying(factor))
    layout = lay_out([record], system, FitSettings(STEP), start=np.array([DECAY, 0.0]))
    still = [np.zeros((1, len(layout.problems[0].grid.nodes)))]
    fit = evaluate(FitProblem(layout), np.array([DECAY, 0.0]), still)
    assert fit is not None
    assert fit.variance[0] == pytest.approx(residual**2)
    return fit


def mean_variance_of_x() -> float:
    """Mean over the samples of q (1 - exp(-2 a t)) / (2 a), the variance of x from rest."""
    t = STEP * np.arange(SAMPLES)
    return float(np.mean(FORCING * (1.0 - np.exp(-2.0 * DECAY * t)) / (2.0 * DECAY)))


@pytest.mark.parametrize("factor", [1.0, 5.0])
@pytest.mark.parametrize(("residual", "noise"), [(0.5, 0.1), (0.5, 0.4), (0.2, 0.19)])
def test_the_motion_accounts_for_the_variance_beyond_the_noise(
    residual: float, noise: float, factor: float
) -> None:
    """factor^2 var(H x) + noise^2 = residual^2, in whatever unit the output is."""
    found = _intensity_factor(fit_with(factor * residual, factor), np.array([factor * noise]))
    assert found**2 * mean_variance_of_x() + noise**2 == pytest.approx(residual**2, rel=1e-4)


@pytest.mark.parametrize("noise", [0.4, 3.0])
def test_without_an_excess_a_hundredth_of_the_noise_is_left_to_the_motion(noise: float) -> None:
    found = _intensity_factor(fit_with(0.3), np.array([noise]))
    assert found**2 * mean_variance_of_x() == pytest.approx((0.01 * noise) ** 2, rel=1e-4)


def test_a_start_is_at_most_a_hundredfold_off() -> None:
    assert _intensity_factor(fit_with(1e3), np.array([0.1])) == 100.0
    assert _intensity_factor(fit_with(1e-6), np.array([1e-7])) == 0.01


def test_only_intensities_are_kept_off_zero() -> None:
    """The intensity of turbulence alone forces its state; at zero the likelihood is flat."""
    record = Record(
        STEP * np.arange(50),
        (Channel.of("elevator", "rad", np.zeros(50)),),
        tuple(Channel.of(name, "1", np.zeros(50)) for name in ("alpha", "q", "nz")),
    )
    layout = lay_out([record], compile_model(rough_model()), FitSettings(STEP))
    at = layout.shared.index("gust-turbulence.sigma")
    values: Mapping[int, float] = _intensities(layout)
    assert values == {at: layout.start[at]}
    low = _with_positive_intensities(layout).low
    assert layout.low[at] == 0.0 and low[at] == pytest.approx(1e-3 * layout.start[at])
    assert np.array_equal(np.delete(low, at), np.delete(layout.low, at))


def test_measurement_noise_starts_between_a_fiftieth_of_the_residual_and_the_residual() -> None:
    """Third differences: 8 r of residuals +r, -r, ..., sqrt(20) r of white, zero of constant
    ones.
    """
    fit = fit_with(0.5)
    assert noise_start(fit) == pytest.approx([0.5])
    weighted = replace(fit.weighted, residuals=(0.5 * np.ones((1, SAMPLES)),))
    assert noise_start(replace(fit, weighted=weighted)) == pytest.approx([0.02 * 0.5])
