"""What held-out data say: knowledge passed on exactly, events looked for anew, failures told."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.fitted_model import FittedModel
from ident.tracing.held_out import HeldOut, fails_residual_tests, fit_held_out, training_prior
from ident.tracing.predictive import prediction
from ident.tracing.wrong_samples import measured_masks
from sim.effects.disturbance.gusts import GustDiscrete
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.record import Channel, Record
from tests.tracing_problem import OUTPUTS, fit_of, planted, problem_of, with_output
from tests.unit.ident.tracing.conftest import LAG, PULSE


def test_the_training_prior_is_the_schur_complement_of_its_information(fitted: FittedModel) -> None:
    normal, _ = fitted.fit.normal_equations()
    n = len(fitted.fit.layout.shared)
    assert n < len(fitted.fit.theta)
    A, B, D = normal[:n, :n], normal[:n, n:], normal[n:, n:]
    # Scaled, since the parameters differ by orders of magnitude.
    scale = np.sqrt(np.diag(A))
    expected = (A - B @ np.linalg.solve(D, B.T)) / np.outer(scale, scale)
    prior = training_prior(fitted)
    np.testing.assert_array_equal(prior.positions, np.arange(n))
    np.testing.assert_array_equal(prior.mean, fitted.fit.theta[:n])
    np.testing.assert_allclose(
        prior.information / np.outer(scale, scale), expected, rtol=0, atol=1e-7
    )
    assert np.linalg.eigvalsh(expected)[0] > 0


@pytest.mark.long
def test_a_frozen_fit_keeps_shared_parameters_bit_for_bit(fitted: FittedModel) -> None:
    validation = [planted([SensorLag("q")], LAG, 9)]
    out = fit_held_out(fitted, validation, measured_masks(validation, OUTPUTS))
    assert out.frozen is not None and out.informed is not None
    shared = fitted.values.shared
    assert "sensor-lag:q.time_constant" in shared and "Cm_alpha" in shared
    frozen = out.frozen.layout.system.parameters
    assert {name: frozen[name].value for name in shared} == shared
    assert not any(frozen[name].free for name in shared)
    assert out.frozen.layout.shared == ()
    # Under training's knowledge they move, by no more than both records together allow.
    moved = out.informed.theta[: len(shared)] - np.array(list(shared.values()))
    assert np.any(moved != 0)
    prior = training_prior(fitted)
    assert 0.5 * moved @ prior.information @ moved < 0.5 * len(shared) + 15.0
    assert not fails_residual_tests(out)


@pytest.mark.long
def test_events_are_looked_for_anew_in_held_out_records(fitted: FittedModel) -> None:
    """The event of a held-out record is at another time, and of another sign, than those of
    training.
    """
    there = {**PULSE, "unmeasured-input.start": 7.0, "unmeasured-input.moment": -0.006}
    out = fit_held_out(
        fitted,
        [planted([SensorLag("q"), UnmeasuredInput()], {**LAG, **there}, 9)],
        None,
        informed=False,
    )
    assert out.frozen is not None and out.informed is None
    own = dict(zip(out.frozen.layout.names, out.frozen.theta, strict=True))
    assert own["unmeasured-input.start"] == pytest.approx(7.0, abs=0.15)
    assert own["unmeasured-input.moment"] < -0.003


@pytest.mark.long
def test_two_events_are_each_placed_beside_the_other() -> None:
    """The first of them, placed while the second is unexplained, is placed where that one is, and
    stays there unless it is asked again.
    """
    gust, push = GustDiscrete(), UnmeasuredInput()
    both = {"gust-discrete.peak": 3.0, "gust-discrete.start": 6.5, "gust-discrete.duration": 0.8}
    train = {
        **both,
        "unmeasured-input.start": 2.0,
        "unmeasured-input.duration": 1.5,
        "unmeasured-input.moment": 0.006,
    }
    fitted = fit_of(
        problem_of([planted([push, gust], train)], (push, gust)), [push, gust], None, train
    )
    there = {"gust-discrete.peak": 6.0, "gust-discrete.start": 2.5, "gust-discrete.duration": 0.8}
    there |= {
        "unmeasured-input.start": 7.0,
        "unmeasured-input.duration": 1.5,
        "unmeasured-input.moment": -0.003,
    }
    out = fit_held_out(fitted, [planted([push, gust], there, 9)], None, informed=False)
    assert out.frozen is not None and not fails_residual_tests(HeldOut(None, out.frozen))
    own = dict(zip(out.frozen.layout.names, out.frozen.theta, strict=True))
    assert own["unmeasured-input.start"] == pytest.approx(7.0, abs=0.15) and own[
        "gust-discrete.start"
    ] == pytest.approx(2.5, abs=0.15)


def test_wrong_frozen_values_are_doubted(fitted: FittedModel) -> None:
    validation = [
        planted([SensorLag("q"), SensorScale("nz")], {**LAG, "sensor-scale:nz.scale": 0.6}, 9)
    ]
    without = fit_of(problem_of([planted(seed=1)]))
    assert fails_residual_tests(fit_held_out(without, validation, None))


@pytest.mark.long
def test_a_prediction_covers_every_row_also_where_the_fit_failed(fitted: FittedModel) -> None:
    record = planted(seed=9)
    values = record["alpha"].values.copy()
    values[5:50] = np.nan
    record = with_output(record, "alpha", values)
    out = fit_held_out(fitted, [record], None, informed=False)
    rows = prediction(out.frozen, 0, record, OUTPUTS)
    assert rows.shape == (3, len(record)) and np.all(np.isfinite(rows))
    failed = prediction(None, 0, record, ["nz", "alpha"])
    assert failed.shape == (2, len(record)) and np.all(np.isfinite(failed))
    np.testing.assert_allclose(failed[1], np.nanmean(values))


def test_a_fit_that_fails_says_so(fitted: FittedModel) -> None:
    """An input beyond the range of floats has no finite cost."""
    record = planted(seed=9)
    elevator = Channel.of("elevator", "rad", 1e300 * record["elevator"].values)
    broken = Record(record.time, (elevator,), record.outputs, record.hold)
    assert fit_held_out(fitted, [broken], None, informed=False).frozen is None
