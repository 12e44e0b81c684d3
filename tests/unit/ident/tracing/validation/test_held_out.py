"""What held-out data say: figures by hand, honest p-values, knowledge passed on exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Candidate
from ident.tracing.spikes.masks import measured_masks
from ident.tracing.validation.error_figures import error_figures, prediction
from ident.tracing.validation.held_out import HeldOutData, doubted, held_out, with_held_out_change
from ident.tracing.validation.training_knowledge import training_prior
from ident.tracing.validation.whiteness import low_frequency_power, whiteness
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Channel, Record
from tests.tracing_problem import OUTPUTS, fit_of, planted, problem_of, with_output, without_output

PULSE = {"unmeasured-input.start": 4.0, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.006, "unmeasured-input.lift": 0.0}
LAG = {"sensor-lag:q.time_constant": 0.05}


@pytest.fixture(scope="module")
def fitted() -> FittedModel:
    """Two records, a shared effect and one of each record."""
    effects = (SensorLag("q"), UnmeasuredInput())
    problem = problem_of([planted(effects, {**LAG, **PULSE}, seed) for seed in (1, 2)])
    return fit_of(problem, effects, None, {**LAG, **PULSE})


def record_of(rows: dict[str, np.ndarray]) -> Record:
    count = len(next(iter(rows.values())))
    return Record(0.02 * np.arange(count), (), tuple(Channel.of(name, "1", values) for name, values in rows.items()))


FINITE = st.floats(-100.0, 100.0).map(lambda v: round(v, 3))


@given(st.lists(st.tuples(FINITE, FINITE, st.booleans()), min_size=5, max_size=40), st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=20))
@settings(max_examples=60)
def test_error_figures_are_the_textbook_formulas_over_all_records(first: list[tuple[float, float, bool]], second: list[tuple[float, float]]) -> None:
    z1, p1, kept = (np.array(column) for column in zip(*first, strict=True))
    z2, p2 = (np.array(column) for column in zip(*second, strict=True))
    kept = kept.astype(bool)
    z, p = np.concatenate([z1[kept], z2]), np.concatenate([p1[kept], p2])
    records = [record_of({"q": z1}), record_of({"q": z2})]
    figures = error_figures([p1[None], p2[None]], records, [kept[None], np.ones((1, len(z2)), dtype=bool)], ["q"])
    residual_squares, total_squares = np.sum((z - p) ** 2), np.sum((z - np.mean(z)) ** 2)
    rmse = np.sqrt(residual_squares / len(z))
    assert figures.rmse["q"] == pytest.approx(rmse, rel=1e-9, abs=1e-12)
    if total_squares > 1e-9:
        assert figures.nrmse["q"] == pytest.approx(rmse / np.std(z), rel=1e-6)
        assert figures.r2["q"] == pytest.approx(1.0 - residual_squares / total_squares, rel=1e-6, abs=1e-9)
    size = np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(p**2))
    if size > 0:
        assert figures.theil["q"] == pytest.approx(rmse / size, rel=1e-9, abs=1e-12)
        assert 0.0 <= figures.theil["q"] <= 1.0 + 1e-12


def test_error_figures_of_what_is_not_there() -> None:
    """A channel at rest has no spread; one without a sample kept has no figures; one that a record lacks is taken from the others."""
    flat = record_of({"q": np.full(6, 2.0), "nz": np.arange(6.0)})
    other = record_of({"q": np.full(6, 2.0)})
    masks = [np.array([[True] * 6, [False] * 6]), np.array([[True] * 6, [False] * 6])]
    figures = error_figures([np.full((2, 6), 2.5), np.full((2, 6), 1.5)], [flat, other], masks, ["q", "nz"])
    assert figures.rmse == {"q": pytest.approx(0.5)}
    assert figures.nrmse == {"q": 0.0} and figures.r2 == {"q": 0.0}
    assert set(figures.theil) == {"q"}


def uniform_distance(p_values: np.ndarray) -> float:
    """Kolmogorov's distance from the uniform distribution."""
    ordered, n = np.sort(p_values), len(p_values)
    return float(np.max(np.maximum(np.arange(1, n + 1) / n - ordered, ordered - np.arange(n) / n)))


@pytest.mark.parametrize(("count", "interval", "missing"), [(501, 0.02, 0.0), (400, 0.05, 0.0), (501, 0.02, 0.1)])
def test_low_frequency_power_has_uniform_p_values_on_white_noise(count: int, interval: float, missing: float) -> None:
    rng = np.random.default_rng(count)
    time = interval * np.arange(count)
    runs = 1500
    p = np.array([low_frequency_power(rng.standard_normal(count), rng.random(count) >= missing, time, "q").p_value for _ in range(runs)])
    # Exceeded once in a thousand such tests: sqrt(-ln(0.0005)/2)/sqrt(n).
    assert uniform_distance(p) < 1.95 / np.sqrt(runs)


def test_low_frequency_power_sees_slow_motion_and_not_fast() -> None:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(500)
    white, valid = rng.standard_normal(500), np.ones(500, dtype=bool)
    slow = low_frequency_power(white + np.sin(2.0 * np.pi * 1.0 * time), valid, time, "q")
    fast = low_frequency_power(white + np.sin(2.0 * np.pi * 9.0 * time), valid, time, "q")
    assert slow.p_value < 1e-12 and slow.statistic > 2.0
    assert fast.p_value > 0.9 and fast.statistic < 1.0


def test_low_frequency_power_says_nothing_where_all_lies_below() -> None:
    test = low_frequency_power(np.ones(100), np.ones(100, dtype=bool), 0.2 * np.arange(100.0), "altitude")
    assert test.p_value == 1.0 and np.isfinite(test.statistic)
    assert low_frequency_power(np.zeros(500), np.ones(500, dtype=bool), 0.02 * np.arange(500), "q").p_value == 1.0


def test_whiteness_tests_every_channel_with_enough_samples_of_every_record(fitted: FittedModel) -> None:
    tests = whiteness(fitted.fit, "fitted")
    assert len(tests) == 2 * 3 * 2
    assert {test.channel for test in tests} == {f"{name}, fitted record {r}" for name in OUTPUTS for r in (1, 2)}
    assert min(test.p_value for test in tests) > 1e-4
    short = without_output(planted(), "nz")
    alpha = short["alpha"].values.copy()
    alpha[15:] = np.nan
    few = fit_of(problem_of([with_output(short, "alpha", alpha)]))
    assert {test.channel for test in whiteness(few.fit, "fitted")} == {"q, fitted"}


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
    np.testing.assert_allclose(prior.information / np.outer(scale, scale), expected, rtol=0, atol=1e-7)
    assert np.linalg.eigvalsh(expected)[0] > 0


def test_a_frozen_fit_keeps_shared_parameters_bit_for_bit(fitted: FittedModel) -> None:
    validation = [planted([SensorLag("q")], LAG, 9)]
    out = held_out(fitted, validation, measured_masks(validation, OUTPUTS))
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
    assert not doubted(out)


def test_events_are_looked_for_anew_in_held_out_records(fitted: FittedModel) -> None:
    """The event of a held-out record is at another time, and of another sign, than those of training."""
    there = {**PULSE, "unmeasured-input.start": 7.0, "unmeasured-input.moment": -0.006}
    out = held_out(fitted, [planted([SensorLag("q"), UnmeasuredInput()], {**LAG, **there}, 9)], None, informed=False)
    assert out.frozen is not None and out.informed is None
    own = dict(zip(out.frozen.layout.names, out.frozen.theta, strict=True))
    assert own["unmeasured-input.start"] == pytest.approx(7.0, abs=0.15)
    assert own["unmeasured-input.moment"] < -0.003


def test_wrong_frozen_values_are_doubted(fitted: FittedModel) -> None:
    validation = [planted([SensorLag("q"), SensorScale("nz")], {**LAG, "sensor-scale:nz.scale": 0.6}, 9)]
    without = fit_of(problem_of([planted(seed=1)]))
    assert doubted(held_out(without, validation, None))


def test_a_prediction_covers_every_row_also_where_the_fit_failed(fitted: FittedModel) -> None:
    record = planted(seed=9)
    values = record["alpha"].values.copy()
    values[5:50] = np.nan
    record = with_output(record, "alpha", values)
    out = held_out(fitted, [record], None, informed=False)
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
    assert held_out(fitted, [broken], None, informed=False).frozen is None


def test_what_was_weighed_on_held_out_data_keeps_its_change() -> None:
    record, other = planted([SensorLag("q")], LAG, 1), planted([SensorLag("q")], LAG, 2)
    problem = problem_of([record])
    root, lagged = fit_of(problem), fit_of(problem, (SensorLag("q"),), None, LAG)
    held = HeldOutData([other], None, held_out(root, [other], None, informed=False))
    gain = root.fit.cost - lagged.fit.cost
    weighed = Candidate(1, (), "sensor-lag:q", gain, 0.0, True, True, {}, -0.3)
    found = with_held_out_change([weighed, replace(weighed, held_out_change=None)], {frozenset({"sensor-lag:q"}): lagged}, held)
    assert found[0] is weighed
    assert found[1].held_out_change is not None and -0.9 < found[1].held_out_change < 0.0 and found[1].held_out_change != -0.3
