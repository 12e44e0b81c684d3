"""The extended Kalman filter against a covariance-form Kalman filter on a linear problem, with
every option.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.filters.ekf import (
    SETTLED_SIGMAS,
    FilterSettings,
    OnePass,
    filter_by_complex_step,
    filter_by_filterpy,
    filter_by_table,
    run_ekf,
)
from ident.filters.one_record import Exponential, Taylor, Transition
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Noise
from sim.errors import ModelError
from sim.propagation import Step, euler_step, make_grid, rk4_step
from sim.record import Hold, Record
from tests.linear_problem import matched_record, matrices, oscillator, record_of
from tests.oracles.kalman import Filtered, kalman

DENSITY = {"position": 0.002, "speed": 0.05, "force": 0.01}
NAMES = ("position", "speed", "force", "bias_mixed")
OUTPUTS = ("place", "mixed", "speed")


def oracle(
    record: Record,
    settings: FilterSettings,
    density: dict[str, float],
    terms: int | None,
    start: np.ndarray | None = None,
) -> Filtered:
    model = matrices(density)
    if start is not None:
        model = replace(model, x0=start)
    grid = make_grid(
        record.time,
        settings.max_step if np.isfinite(settings.max_step) else float(np.diff(record.time).max()),
    )
    z, valid = record.output_array(OUTPUTS)
    ramp, euler = record.hold is Hold.LINEAR, settings.step is euler_step
    return kalman(
        model,
        record.time,
        record.input_array(),
        z,
        valid,
        np.diff(grid.sample),
        terms=terms,
        euler=euler,
        ramp=ramp,
    )


def assert_same(
    record: Record,
    settings: FilterSettings,
    density: dict[str, float],
    terms: int | None,
    by: OnePass = filter_by_filterpy,
) -> None:
    estimate, expected = (
        run_ekf(record, compile_model(oscillator(density), online=True), settings, by=by),
        oracle(record, settings, density, terms),
    )
    history = estimate.history
    assert history is not None and estimate.outcome is Outcome.CONVERGED
    assert history.names == NAMES
    pairs: list[tuple[Any, Any]] = [
        (history.mean, expected.x.T),
        (history.std, np.sqrt(np.diagonal(expected.P, axis1=1, axis2=2)).T),
        (history.covariance, expected.P),
        (history.predicted_mean, expected.x_before.T),
        (history.predicted_covariance, expected.P_before),
        (history.transition, expected.Phi),
        (history.log_likelihood, expected.log_likelihood),
        (history.nis, expected.nis),
        (history.innovation, expected.innovation.T),
        (history.innovation_std, expected.innovation_std.T),
        (estimate.values, expected.x[-1, 2:]),
        (estimate.covariance, expected.P[-1, 2:, 2:]),
        (estimate.log_likelihood, expected.log_likelihood.sum()),
    ]
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)
    valid = record.output_array(OUTPUTS)[1]
    np.testing.assert_array_equal(history.valid, valid)
    np.testing.assert_array_equal(history.degrees, valid.sum(axis=0))
    model = matrices(density)
    everywhere = model.C @ expected.x_before.T + model.D @ record.input_array()
    np.testing.assert_allclose(estimate.fitted[0], everywhere, rtol=1e-10, atol=1e-10)


TRANSITIONS = [(Taylor(2), 2), (Taylor(3), 3), (Taylor(5), 5), (Exponential(), None)]


@pytest.mark.sampled
@pytest.mark.parametrize("density", [{}, DENSITY], ids=["quiet", "forced"])
@pytest.mark.parametrize("step", [euler_step, rk4_step])
@pytest.mark.parametrize(
    ("transition", "terms"), TRANSITIONS, ids=["Taylor 2", "Taylor 3", "Taylor 5", "exponential"]
)
@pytest.mark.parametrize("holed", [False, True], ids=["whole", "holed and uneven"])
def test_equals_the_covariance_form(
    density: dict[str, float], step: Step, transition: Transition, terms: int | None, holed: bool
) -> None:
    record = record_of(np.random.default_rng(5), 40, uneven=holed, missing=holed)
    settings = FilterSettings(step, transition, max_step=0.03 if holed else np.inf)
    assert_same(record, settings, density, terms)


@pytest.mark.parametrize("density", [{}, DENSITY], ids=["quiet", "forced"])
@pytest.mark.parametrize("by", [filter_by_table, filter_by_filterpy, filter_by_complex_step])
def test_either_way_equals_the_covariance_form(density: dict[str, float], by: OnePass) -> None:
    record = record_of(np.random.default_rng(5), 40, uneven=True, missing=True)
    assert_same(record, FilterSettings(max_step=0.03), density, 3, by)


@pytest.mark.parametrize("absent", [("mixed",), ("place", "speed")])
@pytest.mark.parametrize("hold", list(Hold))
def test_equals_the_covariance_form_with_absent_channels(
    absent: tuple[str, ...], hold: Hold
) -> None:
    record = record_of(
        np.random.default_rng(6), 40, uneven=True, missing=True, absent=absent, hold=hold
    )
    assert_same(record, FilterSettings(rk4_step, Exponential(), 0.04), DENSITY, None)


def test_every_pass_starts_from_the_parameters_of_the_one_before() -> None:
    # Few noisy samples: the force keeps moving, since each pass takes its own result for its prior
    # mean.
    record = record_of(np.random.default_rng(7), 12)
    density: dict[str, float] = {}
    settings = FilterSettings(passes=4)
    estimate = run_ekf(record, compile_model(oscillator(density), online=True), settings)
    start, done, last = matrices(density).x0, 0, None
    while done < 4:
        done += 1
        result = oracle(record, settings, density, 3, start)
        moved = (
            np.inf
            if last is None
            else np.max(
                np.abs(result.x[-1, 2:] - last.x[-1, 2:]) / np.sqrt(np.diag(last.P[-1])[2:])
            )
        )
        start, last = np.concatenate([start[:2], result.x[-1, 2:]]), result
        if moved < SETTLED_SIGMAS:
            break
    assert last is not None
    assert estimate.iterations == done > 1
    np.testing.assert_allclose(estimate.values, last.x[-1, 2:], rtol=1e-10)
    np.testing.assert_allclose(estimate.covariance, last.P[-1, 2:, 2:], rtol=1e-10)


def test_passes_end_when_nothing_moves() -> None:
    held = oscillator()
    held = held.with_parameters(held.parameters.hold(["force", "bias_mixed"]))
    estimate = run_ekf(
        record_of(np.random.default_rng(8)),
        compile_model(held, online=True),
        FilterSettings(passes=7),
    )
    assert estimate.iterations == 2
    assert estimate.names == () and estimate.covariance.shape == (0, 0)


def test_innovations_of_matched_data_have_their_stated_size() -> None:
    squares, degrees, misses = 0.0, 0, []
    for seed in range(8):
        record = matched_record(np.random.default_rng(seed), 100, DENSITY)
        estimate = run_ekf(
            record,
            compile_model(oscillator(DENSITY), online=True),
            FilterSettings(transition=Exponential()),
        )
        assert estimate.history is not None
        squares, degrees = (
            squares + estimate.history.nis.sum(),
            degrees + int(estimate.history.degrees.sum()),
        )
        misses.append(estimate.history.innovation / estimate.history.innovation_std)
    # The sum is chi-squared with that many degrees; four of its standard deviations.
    assert abs(squares / degrees - 1.0) < 4.0 * np.sqrt(2.0 / degrees)
    assert abs(np.mean(misses)) < 4.0 / np.sqrt(degrees)


def test_an_initial_state_that_is_held_has_no_variance() -> None:
    model = oscillator()
    exact = ParameterSet(
        (Parameter("position", 0.2, "m", free=False), Parameter("speed", -0.1, "m/s", free=False))
    )
    estimate = run_ekf(
        record_of(np.random.default_rng(9)), compile_model(model.with_initial(exact), online=True)
    )
    assert estimate.history is not None
    np.testing.assert_array_equal(estimate.history.predicted_covariance[0, :2], 0.0)
    assert np.all(estimate.std > 0)


def test_names_what_is_not_declared() -> None:
    record, model = record_of(np.random.default_rng(1)), oscillator()
    with pytest.raises(ModelError, match="force: parameter without a prior"):
        run_ekf(
            record,
            compile_model(
                model.with_parameters(model.parameters.with_prior({"force": np.inf})), online=True
            ),
        )
    with pytest.raises(ModelError, match="output mixed: its measurement noise is not declared"):
        run_ekf(
            record,
            compile_model(model.with_noise(Noise({"place": 0.1, "speed": 0.1})), online=True),
        )
    with pytest.raises(ModelError, match="none of the outputs place, mixed, speed"):
        run_ekf(replace(record, outputs=()), compile_model(model, online=True))
