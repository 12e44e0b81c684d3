"""Maximum likelihood with process noise: recovery, consistency with output error, several records,
likelihood of what was not fitted.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.process_noise.filter_error import (
    fit_filter_error,
    fit_with_fixed_noise,
    fit_with_process_noise,
    noise_levels,
    noise_start,
    residual_whiteness_p_value,
)
from ident.process_noise.innovations_model import SCALE, process_noise
from ident.whole_record.gauss_newton import fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.effects.sensor_path.sensor_calibration import SensorStep
from sim.errors import ModelError
from tests.linear_problem import matched_record, oscillator
from tests.turbulence import DERIVATIVES, NOISE, TRUE, calm_model, rough_model, rough_record

SETTINGS = FitSettings(0.02)
OUTPUTS = ("alpha", "q", "nz")


def scores(estimate: Estimate) -> np.ndarray:
    """Errors of the derivatives over their reported sigma."""
    at = [estimate.names.index(name) for name in DERIVATIVES]
    return (estimate.values[at] - TRUE) / estimate.std[at]


@pytest.mark.long
def test_a_record_in_rough_air() -> None:
    record = rough_record(np.random.default_rng(11), 801, length=100.0)
    estimate = fit_filter_error([record], compile_model(rough_model()), SETTINGS)
    assert estimate.outcome is Outcome.CONVERGED
    assert np.all(np.abs(scores(estimate)) < 3.5)
    # Over such records the estimates scatter by 0.10 m/s and 21 m, the reported sigmas with them.
    assert (
        abs(estimate.value("gust-turbulence.sigma") - 1.0) < 0.3
        and 0.05 < estimate.sigma("gust-turbulence.sigma") < 0.15
    )
    assert (
        abs(estimate.value("gust-turbulence.length") - 100.0) < 65.0
        and 8.0 < estimate.sigma("gust-turbulence.length") < 40.0
    )
    assert estimate.noise_std == pytest.approx(NOISE, rel=0.1)
    # On the same scale as output error, which is wrong about its own accuracy here.
    plain = fit_output_error([record], compile_model(calm_model()), SETTINGS)
    assert estimate.log_likelihood > plain.log_likelihood + 500.0
    assert np.all(estimate.std[:6] < 0.5 * plain.std)


@pytest.mark.sampled
@pytest.mark.parametrize("intensity", [0.1, 10.0])
def test_starts_far_off(intensity: float) -> None:
    record = rough_record(np.random.default_rng(12), 601, intensity=intensity)
    estimate = fit_filter_error([record], compile_model(rough_model()), SETTINGS)
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.value("gust-turbulence.sigma") == pytest.approx(
        intensity, abs=4.0 * estimate.sigma("gust-turbulence.sigma")
    )
    assert np.all(np.abs(scores(estimate)) < 4.0)


def test_without_forcing_it_is_output_error() -> None:
    record = rough_record(np.random.default_rng(13), 301, intensity=0.0, missing=0.05)
    system = compile_model(calm_model())
    plain = fit_whole_records(
        FitProblem(lay_out([record], system, replace(SETTINGS, tolerance=1e-6)))
    )
    assert plain is not None
    noise_model = process_noise(system, dict(zip(OUTPUTS, 1.5 * NOISE, strict=True)), OUTPUTS)
    fit = fit_whole_records(FitProblem(plain.layout, noise_model))
    assert fit is not None and fit.outcome is Outcome.CONVERGED
    n = len(plain.theta)
    sigma = 1.0 / np.sqrt(np.diag(plain.normal_equations()[0]))
    assert np.max(np.abs(fit.theta[:n] - plain.theta) / sigma) < 1e-4
    assert fit.theta[n:] == pytest.approx(np.sqrt(plain.variance), rel=1e-6)
    assert fit.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-6)
    assert fit.normal_equations()[0][:n, :n] == pytest.approx(plain.normal_equations()[0], rel=1e-4)


def test_calm_air_gains_nothing() -> None:
    record = rough_record(np.random.default_rng(14), 401, intensity=0.0)
    estimate = fit_filter_error(
        [record], compile_model(rough_model()), replace(SETTINGS, tolerance=0.02)
    )
    plain = fit_output_error([record], compile_model(calm_model()), SETTINGS)
    assert -0.1 < estimate.log_likelihood - plain.log_likelihood < 5.0
    assert estimate.value("gust-turbulence.sigma") < 0.1
    assert np.all(np.isfinite(estimate.std)) and np.all(estimate.std > 0)


@pytest.mark.long
def test_several_records_with_their_own_sensors() -> None:
    rng = np.random.default_rng(15)
    records = [rough_record(rng, 501), rough_record(rng, 401, size=-0.04, unit=0.35, missing=0.05)]
    shifted = replace(
        records[1], outputs=tuple(replace(c, values=c.values + 0.05) for c in records[1].outputs)
    )
    system = compile_model(rough_model())
    both = fit_filter_error([records[0], shifted], system, SETTINGS)
    alone = fit_filter_error([records[0]], system, SETTINGS)
    assert both.outcome is Outcome.CONVERGED
    assert np.all(np.abs(scores(both)) < 3.5)
    assert np.all(both.std < alone.std)
    again = fit_filter_error(records, system, SETTINGS)
    assert again.values == pytest.approx(both.values, rel=1e-3)


@pytest.mark.long
def test_missing_samples_cost_accuracy_and_nothing_else() -> None:
    whole, holed = (
        rough_record(np.random.default_rng(16), 601, missing=share) for share in (0.0, 0.25)
    )
    system = compile_model(rough_model())
    full, part = (fit_filter_error([record], system, SETTINGS) for record in (whole, holed))
    assert np.all(np.abs(scores(part)) < 3.5)
    ratio = part.std[:6] / full.std[:6]
    assert np.all((ratio > 1.0) & (ratio < 1.5))


def test_scale_of_declared_process_noise() -> None:
    true = {"speed": 0.4}
    record = matched_record(np.random.default_rng(17), 600, true)
    model = oscillator({"speed": 0.4 / 9.0}).with_values({"force": 0.0})
    estimate = fit_filter_error([record], compile_model(model), FitSettings(0.05))
    assert estimate.outcome is Outcome.CONVERGED and estimate.names == ("force", SCALE)
    assert abs(estimate.value(SCALE) - 3.0) < 3.0 * estimate.sigma(SCALE) < 1.0
    # The force is known as well as its noise lets know: sqrt(density / duration).
    assert estimate.sigma("force") == pytest.approx(math.sqrt(0.4 / 30.0), rel=0.3)


def test_a_warm_start_ends_where_the_cold_one_does() -> None:
    record = rough_record(np.random.default_rng(18), 401)
    layout = lay_out([record], compile_model(rough_model()), SETTINGS)
    cold = fit_with_process_noise(layout)
    assert cold is not None
    start = cold.theta[: len(layout.start)].copy()
    start[:6] *= 1.05
    warm = fit_with_process_noise(
        replace(layout, start=start),
        cold.trajectories,
        noise_levels(cold),
    )
    assert warm is not None and warm.iterations < cold.iterations + 2
    assert warm.log_likelihood == pytest.approx(cold.log_likelihood, abs=1e-4)


def test_whitened_signatures_go_with_whitened_residuals() -> None:
    record = rough_record(np.random.default_rng(19), 301, missing=0.1)
    fit = fit_with_process_noise(lay_out([record], compile_model(rough_model()), SETTINGS))
    assert fit is not None
    assert fit.whiten(0, fit.linearisations[0].jacobian) == pytest.approx(
        fit.jacobians[0], rel=1e-12, abs=1e-12
    )
    plain = fit_whole_records(FitProblem(lay_out([record], compile_model(calm_model()), SETTINGS)))
    assert plain is not None
    white = plain.whiten(0, plain.residuals[0][:, :, None])[:, :, 0]
    assert (white**2).sum(axis=1) == pytest.approx(plain.counts, rel=1e-12)


def test_noise_is_read_off_residuals_that_hold_motion() -> None:
    record = rough_record(np.random.default_rng(20), 801, intensity=1.0, missing=0.05)
    fit = fit_whole_records(FitProblem(lay_out([record], compile_model(calm_model()), SETTINGS)))
    assert fit is not None
    assert noise_start(fit) == pytest.approx(NOISE, rel=0.25)
    assert np.sqrt(fit.variance[0]) > 1.5 * NOISE[0]


@pytest.mark.parametrize(("intensity", "worth"), [(0.0, False), (0.3, True)])
def test_turbulence_is_worth_trying_where_residuals_are_not_white(
    intensity: float, worth: bool
) -> None:
    fit = fit_whole_records(
        FitProblem(
            lay_out(
                [rough_record(np.random.default_rng(21), 501, intensity=intensity)],
                compile_model(calm_model()),
                SETTINGS,
            )
        )
    )
    assert fit is not None
    assert (residual_whiteness_p_value(fit) < 1e-2) is worth


@pytest.mark.long
def predictive_log_likelihood(*arguments: Any, **options: Any) -> float:
    fit = fit_with_fixed_noise(*arguments, **options)
    assert fit is not None
    return fit.log_likelihood


def test_prediction_of_a_record_that_was_not_fitted() -> None:
    rng = np.random.default_rng(22)
    train, other = rough_record(rng, 501), rough_record(rng, 401, size=-0.04, unit=0.35)
    rough, calm = compile_model(rough_model()), compile_model(calm_model())
    found, plain = (
        fit_filter_error([train], rough, SETTINGS),
        fit_output_error([train], calm, SETTINGS),
    )
    with_gusts = predictive_log_likelihood(
        [other],
        rough,
        found.as_dict(),
        dict(zip(OUTPUTS, found.noise_std.tolist(), strict=True)),
        SETTINGS,
    )
    without = predictive_log_likelihood(
        [other],
        calm,
        plain.as_dict(),
        dict(zip(OUTPUTS, plain.noise_std.tolist(), strict=True)),
        SETTINGS,
    )
    assert with_gusts > without + 300.0
    # As good as a fit of that record itself, but for the parameters' errors.
    own = fit_filter_error([other], rough, SETTINGS)
    assert own.log_likelihood - 25.0 < with_gusts < own.log_likelihood


def test_an_event_of_a_record_that_was_not_fitted_is_predicted_from_where_it_was_found() -> None:
    """A zero of alpha that jumps: from another time no slope leads there."""
    step = SensorStep("alpha", "rad", 1e-3)
    record = rough_record(np.random.default_rng(24), 401)
    jumped = np.where(
        record.time >= record.time[250], record["alpha"].values + 0.02, record["alpha"].values
    )
    record = replace(
        record,
        outputs=tuple(
            replace(c, values=jumped) if c.name == "alpha" else c for c in record.outputs
        ),
    )
    system = compile_model(rough_model().with_effects(step))
    values = dict(zip(DERIVATIVES, TRUE.tolist(), strict=True))
    levels, local = (
        dict(zip(OUTPUTS, NOISE.tolist(), strict=True)),
        ["sensor-step:alpha.at", "sensor-step:alpha.size"],
    )
    found = {"sensor-step:alpha.at": float(record.time[250]), "sensor-step:alpha.size": 0.02}
    there = predictive_log_likelihood(
        [record], system, values, levels, SETTINGS, local=local, begin=[found]
    )
    elsewhere = {"sensor-step:alpha.at": float(record.time[40]), "sensor-step:alpha.size": 0.001}
    assert (
        there
        > predictive_log_likelihood(
            [record], system, values, levels, SETTINGS, local=local, begin=[elsewhere]
        )
        + 20.0
    )


def test_prediction_without_process_noise_is_gaussian() -> None:
    record = rough_record(np.random.default_rng(23), 201, intensity=0.0)
    system = compile_model(calm_model(1.0))
    values = dict(zip(DERIVATIVES, TRUE.tolist(), strict=True))
    got = predictive_log_likelihood(
        [record], system, values, dict(zip(OUTPUTS, NOISE.tolist(), strict=True)), SETTINGS
    )
    held = replace(
        system, parameters=system.parameters.only_free(["bias_alpha", "bias_q", "bias_nz"])
    )
    fit = fit_whole_records(
        FitProblem(
            lay_out([record], held, SETTINGS),
            process_noise(held, dict(zip(OUTPUTS, NOISE, strict=True)), (), fixed=True),
        )
    )
    assert fit is not None
    e = (fit.layout.problems[0].z - fit.linearisations[0].y) / NOISE[:, None]
    expected = (
        -0.5 * float(np.sum(e**2))
        - 201 * float(np.sum(np.log(NOISE)))
        - 1.5 * 201 * math.log(2.0 * math.pi)
    )
    assert got == pytest.approx(expected, abs=1e-6)


def test_a_model_that_nothing_forces_is_refused() -> None:
    with pytest.raises(ModelError, match="no white noise acts on a state"):
        fit_filter_error([rough_record(np.random.default_rng(24), 60)], compile_model(calm_model()))


@pytest.mark.slow
def test_intervals_over_many_records() -> None:
    """30 records of rough air: derivatives, intensity and length within their sigmas; output error
    is neither as good nor honest.

    Each record holds 24 correlation lengths; with fewer, intensity and length come out too small
    (by a tenth with 8).
    """
    rough, calm = compile_model(rough_model()), compile_model(calm_model())
    errors, levels, plain = [], [], []
    for seed in range(30):
        record = rough_record(np.random.default_rng(1000 + seed), 601, length=100.0)
        found = fit_filter_error([record], rough, SETTINGS)
        assert found.outcome is Outcome.CONVERGED
        errors.append([scores(found), found.values[:6] - TRUE])
        levels.append(
            [
                (found.value(f"gust-turbulence.{name}") - true)
                / found.sigma(f"gust-turbulence.{name}")
                for name, true in (("sigma", 1.0), ("length", 100.0))
            ]
        )
        white = fit_output_error([record], calm, replace(SETTINGS, coloured=False))
        plain.append([scores(white), white.values - TRUE])
    gusts = np.array(levels)
    z, error = np.array(errors).transpose(1, 0, 2)
    z_plain, error_plain = np.array(plain).transpose(1, 0, 2)
    # 180 numbers, correlated within a record: 95.4 % expected, three sigmas of a share of 90
    # independent ones below it allowed.
    assert np.mean(np.abs(z) < 2.0) > 0.954 - 3.0 * math.sqrt(0.954 * 0.046 / 90.0)
    assert 0.7 < np.mean(z**2) < 1.45
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.0 / math.sqrt(30.0))
    assert np.mean(np.abs(gusts) < 2.0) > 0.954 - 3.0 * math.sqrt(0.954 * 0.046 / 30.0)
    assert np.mean(np.abs(z_plain) < 2.0) < 0.7
    assert np.all(
        np.sqrt(np.mean(error**2, axis=0)) < 0.5 * np.sqrt(np.mean(error_plain**2, axis=0))
    )


def test_the_curvature_that_recent_steps_showed_saves_iterations() -> None:
    """With the expected information alone, or its correction turned round, this fit takes 16."""
    layout = lay_out(
        [rough_record(np.random.default_rng(2), 201)],
        compile_model(rough_model()),
        replace(SETTINGS, tolerance=1e-5),
    )
    fit = fit_with_process_noise(layout)
    assert fit is not None and fit.outcome is Outcome.CONVERGED
    assert fit.iterations <= 13
