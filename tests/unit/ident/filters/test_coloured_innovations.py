"""Standard deviations of a filter under coloured noise: exact algebra on a linear problem, output
error's numbers, scatter over seeds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.filters.ekf import run_ekf, run_iterated_ekf
from ident.filters.smoother import coloured_innovations, smooth, with_coloured_covariance
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.record import Record
from tests.linear_problem import matched_record, matrices, oscillator, record_of
from tests.rigid_problem import rigid_record, rigid_start

COEFFICIENT = 0.9


def coloured(
    record: Record, model_outputs: dict[str, np.ndarray], std: dict[str, float], seed: int
) -> Record:
    """The record's outputs without noise, ``model_outputs``, with first-order autoregressive noise
    of the standard deviations ``std``.
    """
    rng, outputs = np.random.default_rng(seed), []
    for channel in record.outputs:
        white = rng.standard_normal(len(record) + 200)
        noise = np.zeros_like(white)
        for k in range(1, len(white)):
            noise[k] = COEFFICIENT * noise[k - 1] + np.sqrt(1.0 - COEFFICIENT**2) * white[k]
        outputs.append(
            replace(channel, values=model_outputs[channel.name] + std[channel.name] * noise[200:])
        )
    return replace(record, outputs=tuple(outputs))


@pytest.mark.parametrize("density", [{}, {"speed": 0.05}], ids=["quiet", "forced"])
def test_under_white_noise_the_algebra_gives_back_the_filters_own_covariance(
    density: dict[str, float],
) -> None:
    # The filter of the problem is linear: initial state and parameters by least squares have the
    # covariance of its last sample.
    estimate = run_ekf(
        record_of(np.random.default_rng(3), 60, uneven=True, missing=True),
        compile_model(oscillator(density), online=True),
    )
    found = coloured_innovations(estimate)
    assert found is not None and found.names == estimate.names
    white = np.sqrt(np.diagonal(found.covariance)) / found.factor
    np.testing.assert_allclose(white, estimate.std, rtol=1e-6)


def test_without_process_noise_it_is_close_to_the_correction_of_output_error() -> None:
    record = rigid_record(np.random.default_rng(2))
    exact = dict(zip(record.output_names, record.output_array(record.output_names)[0], strict=True))
    std = {name: 0.1 * float(np.std(values)) for name, values in exact.items()}
    noisy = coloured(record, exact, std, 5)
    model = rigid_start()
    wide = {name: 100.0 * model.parameters[name].prior_std for name in model.parameters.free_names}
    model = replace(model, parameters=model.parameters.with_prior(wide))
    fit, white = (
        fit_output_error([noisy], compile_model(model, tuple(std)), FitSettings(coloured=each))
        for each in (True, False)
    )
    levels = dict(zip(white.output_names, white.noise_std.tolist(), strict=True))
    ready = replace(model, noise=replace(model.noise, measurement_std=levels))
    found = with_coloured_covariance(run_iterated_ekf(noisy, compile_model(ready, online=True)))
    assert found.outcome is Outcome.CONVERGED and fit.outcome is Outcome.CONVERGED
    again = coloured_innovations(found)
    assert again is not None and again.significant and again.factor.max() > 2.0
    assert all(0.7 < value < 1.0 for value in again.lag_one.values())
    for name, factor in zip(again.names, again.factor, strict=True):
        assert found.sigma(name) / factor == pytest.approx(white.sigma(name), rel=0.15), name
        assert found.sigma(name) == pytest.approx(fit.sigma(name), rel=0.25), name


@pytest.mark.long
def test_two_corrected_standard_deviations_hold_the_truth() -> None:
    record = matched_record(np.random.default_rng(1), 150)
    system, linear = compile_model(oscillator({}), online=True), matrices({})
    quiet = run_ekf(record, system)
    assert quiet.history is not None
    # Without process noise the smoothed trajectory is one of the model.
    outputs = linear.C @ smooth(quiet.history).mean + linear.D @ record.input_array()
    exact = dict(zip(quiet.output_names, outputs, strict=True))
    std = {
        name: float(value) for name, value in zip(quiet.output_names, quiet.noise_std, strict=True)
    }
    runs = [run_ekf(coloured(record, exact, std, seed), system) for seed in range(80)]
    errors = np.array([each.values for each in runs]) - quiet.values
    assert np.mean(np.abs(errors) <= 2.0 * np.array([each.std for each in runs])) < 0.5
    # Sigmas from 150 samples with a memory of ten are Student's: wider than the scatter on average.
    held = np.mean(
        np.abs(errors) <= 2.0 * np.array([with_coloured_covariance(each).std for each in runs])
    )
    assert 0.90 < held < 0.98, held


def test_one_cause_in_several_outputs_widens_the_standard_deviations_by_its_cross_spectrum() -> (
    None
):
    record = rigid_record(np.random.default_rng(2))
    exact = dict(zip(record.output_names, record.output_array(record.output_names)[0], strict=True))
    std = {name: 0.05 * float(np.std(values)) for name, values in exact.items()}
    shared = coloured(record, exact, std, 5)
    first = record.output_names[0]
    cause = (shared[first].values - exact[first]) / std[first]
    rows = (
        replace(each, values=exact[each.name] + std[each.name] * cause) for each in record.outputs
    )
    moved = replace(record, outputs=tuple(rows))
    model = rigid_start()
    model = replace(model, noise=replace(model.noise, measurement_std=std))
    estimate = run_iterated_ekf(moved, compile_model(model, online=True))
    found = coloured_innovations(estimate)
    assert found is not None
    fit = fit_output_error([moved], compile_model(model, tuple(std)))
    for name, variance in zip(found.names, np.diagonal(found.covariance), strict=True):
        assert np.sqrt(variance) == pytest.approx(fit.sigma(name), rel=0.25), name


def test_a_filter_that_broke_down_has_no_correction() -> None:
    estimate = run_ekf(
        record_of(np.random.default_rng(3), 30), compile_model(oscillator({}), online=True)
    )
    broken = replace(estimate, outcome=Outcome.DIVERGED)
    assert coloured_innovations(broken) is None and with_coloured_covariance(broken) is broken
    assert coloured_innovations(replace(estimate, history=None)) is None
