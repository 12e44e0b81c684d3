"""Unscented filter and fixed-interval smoother against covariance-form oracles, and against the
extended filter.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.estimate import Outcome
from ident.filters.ekf import FilterSettings, run_ekf
from ident.filters.one_record import Exponential, Taylor, Transition
from ident.filters.smoother import smooth
from ident.filters.ukf import run_ukf, square_root, statistical_slopes
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.propagation import Step, euler_step, make_grid, rk4_step
from tests.linear_problem import matrices, oscillator, record_of
from tests.oracles.kalman import kalman, rts
from tests.rigid_problem import TRUE, ballistic_record, ballistic_start, rigid_record, rigid_start

DENSITY = {"position": 0.002, "speed": 0.05, "force": 0.01, "bias_mixed": 0.001}
OUTPUTS = ("place", "mixed", "speed")


@pytest.mark.sampled
@pytest.mark.parametrize("density", [{}, DENSITY], ids=["quiet", "forced"])
@pytest.mark.parametrize(("step", "terms"), [(euler_step, 2), (rk4_step, 5)])
@pytest.mark.parametrize("run", [run_ekf, run_ukf])
def test_linear_problem_equals_the_oracles(
    run: object, density: dict[str, float], step: Step, terms: int
) -> None:
    record = record_of(np.random.default_rng(4), 50, uneven=True, missing=True, absent=("speed",))
    settings = FilterSettings(step, Taylor(terms), 0.05)
    estimate = run(record, compile_model(oscillator(density), online=True), settings)  # type: ignore[operator]
    z, valid = record.output_array(OUTPUTS)
    pieces = np.diff(make_grid(record.time, 0.05).sample)
    expected = kalman(
        matrices(density),
        record.time,
        record.input_array(),
        z,
        valid,
        pieces,
        terms=terms,
        euler=step is euler_step,
        ramp=False,
    )
    history = estimate.history
    pairs = [
        (history.mean, expected.x.T),
        (history.covariance, expected.P),
        (history.predicted_covariance, expected.P_before),
        (history.transition, expected.Phi),
        (history.log_likelihood, expected.log_likelihood),
        (history.nis, expected.nis),
        (history.innovation, expected.innovation.T),
        (history.innovation_std, expected.innovation_std.T),
    ]
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)
    smoothed = smooth(history)
    x, P = rts(expected)
    np.testing.assert_allclose(smoothed.mean, x.T, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(smoothed.covariance, P, rtol=1e-8, atol=1e-8)
    assert np.all(smoothed.std <= history.std)
    assert np.any(smoothed.std < 0.9 * history.std)
    np.testing.assert_array_equal(smoothed.mean[:, -1], history.mean[:, -1])


@pytest.mark.parametrize("run", [run_ekf, run_ukf])
def test_exactly_known_states_smooth_without_a_nan(run: object) -> None:
    # No variance at the start, none ever of the position's equation at the first step: the
    # prediction is singular.
    model = oscillator().with_initial(
        ParameterSet(
            (
                Parameter("position", 0.2, "m", free=False),
                Parameter("speed", -0.1, "m/s", free=False),
            )
        )
    )
    model = model.with_parameters(model.parameters.hold(["bias_mixed"]))
    estimate = run(
        record_of(np.random.default_rng(5), 40),
        compile_model(model, online=True),
        FilterSettings(transition=Taylor(5)),
    )  # type: ignore[operator]
    smoothed = smooth(estimate.history)
    assert np.all(np.isfinite(smoothed.mean)) and np.all(np.isfinite(smoothed.covariance))
    np.testing.assert_allclose(smoothed.std[:2, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(smoothed.mean[:2, 0], [0.2, -0.1], atol=1e-12)
    # A constant without process noise has one value, that of the last sample.
    np.testing.assert_allclose(smoothed.mean[2], estimate.values[0], rtol=1e-8)
    np.testing.assert_allclose(smoothed.std[2], estimate.std[0], rtol=1e-6)


def test_filters_and_smoothers_agree_on_the_aircraft() -> None:
    record, system = (
        rigid_record(np.random.default_rng(6), 6.0, 25.0),
        compile_model(rigid_start(), online=True),
    )
    extended, unscented = (
        run(record, system, FilterSettings(passes=3)) for run in (run_ekf, run_ukf)
    )
    assert extended.outcome is unscented.outcome is Outcome.CONVERGED
    assert np.max(np.abs(unscented.values - extended.values) / extended.std) < 0.5
    np.testing.assert_allclose(unscented.std, extended.std, rtol=0.1)
    for estimate in (extended, unscented):
        assert np.max(np.abs(estimate.values - TRUE) / estimate.std) < 3.5
        assert estimate.history is not None
        smoothed = smooth(estimate.history)
        assert np.all(smoothed.std <= estimate.history.std)
        assert np.ptp(smoothed.mean[2:] / estimate.std[:, None], axis=1).max() < 1e-3
    a, b = (smooth(e.history) for e in (extended, unscented) if e.history is not None)
    assert np.max(np.abs(a.mean[:2] - b.mean[:2]) / a.std[:2]) < 2.0


@pytest.mark.sampled
@pytest.mark.parametrize("transition", [Taylor(2), Exponential()])
def test_smoothing_helps(transition: Transition) -> None:
    system, record = (
        compile_model(ballistic_start(2200.0), online=True),
        ballistic_record(np.random.default_rng(3)),
    )
    for run in (run_ekf, run_ukf):
        estimate = run(record, system, FilterSettings(transition=transition, max_step=0.05))
        assert estimate.outcome is Outcome.CONVERGED and estimate.history is not None
        smoothed = smooth(estimate.history)
        middle = len(record) // 2
        assert smoothed.std[0, middle] < 0.6 * estimate.history.std[0, middle]
        assert (
            abs(smoothed.mean[1, 0] + 1828.8)
            < 4.0 * smoothed.std[1, 0]
            < 0.5 * estimate.history.std[1, 0]
        )


@given(
    seed=st.integers(0, 10**6),
    known=st.lists(st.integers(0, 4), max_size=3),
    spread=st.floats(0.0, 6.0),
)
def test_roots_of_singular_covariances(seed: int, known: list[int], spread: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5)) * 10.0 ** rng.uniform(-spread, spread, (5, 1))
    root[known] = 0.0
    P = root @ root.T
    scale = np.sqrt(np.diag(P)) + 1e-100
    U, linear = square_root(P), rng.normal(size=(2, 5))
    assert np.max(np.abs(U.T @ U - P) / np.outer(scale, scale)) < 1e-12
    np.testing.assert_array_equal(U[:, known], 0.0)
    # Of a linear function the slopes are its own, wherever there is variance.
    found = statistical_slopes(P, U @ linear.T)
    np.testing.assert_array_equal(found[:, known], 0.0)
    kept = np.isin(np.arange(5), known, invert=True)
    difference = (found - linear) * kept * scale
    assert np.max(np.abs(difference)) < 1e-6 * np.max(np.abs(linear * scale) + 1e-100)


@given(seed=st.integers(0, 10**6), correlation=st.sampled_from([0.0, 0.3, 0.9]))
def test_points_do_not_turn_with_rounding(seed: int, correlation: float) -> None:
    # Alike correlations have no axes of their own: an error of the size of rounding must not choose
    # where the points lie.
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-3.0, 3.0, 4)
    error = rng.uniform(-1.0, 1.0, (4, 4)) * 1e-15
    exact = np.full((4, 4), correlation) + (1.0 - correlation) * np.eye(4)
    one, other = (square_root(C * np.outer(scale, scale)) for C in (exact, exact + error + error.T))
    assert np.max(np.abs(one - other) / scale) < 1e-13
