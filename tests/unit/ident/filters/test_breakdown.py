"""Filters and smoother on hopeless starts: an outcome code and finite numbers, never a NaN."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.estimate import Estimate, Outcome
from ident.filters.ekf import FilterSettings, run_ekf
from ident.filters.one_record import Exponential
from ident.filters.problem import breakdown
from ident.filters.smoother import smooth
from ident.filters.ukf import run_ukf
from sim.declaration.compile import compile_model
from sim.propagation import euler_step
from sim.record import Channel, Record
from tests.rigid_problem import ballistic_record, ballistic_start, rigid_record, rigid_start

Filter = Callable[..., Estimate]
FILTERS = [run_ekf, run_ukf]


def assert_finite(estimate: Estimate) -> None:
    arrays = [
        estimate.values,
        estimate.covariance,
        estimate.std,
        estimate.noise_std,
        np.array(estimate.log_likelihood),
        *estimate.fitted,
    ]
    history = estimate.history
    assert history is not None
    arrays += [getattr(history, field.name) for field in fields(history) if field.name != "names"]
    arrays += [smooth(history).mean, smooth(history).std, smooth(history).covariance]
    assert all(np.all(np.isfinite(array)) for array in arrays)
    assert np.all(history.std >= 0) and np.all(np.diag(estimate.covariance) >= 0)
    assert (estimate.message == "") == (estimate.outcome is Outcome.CONVERGED)


wild = st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(-3.0, 12.0)).map(
    lambda pair: pair[0] * 10.0 ** pair[1]
)


@pytest.mark.parametrize("run", FILTERS)
@settings(max_examples=6)
@given(
    factors=st.lists(wild, min_size=6, max_size=6),
    prior=st.floats(-2.0, 6.0),
    passes=st.integers(1, 3),
)
def test_wild_aircraft(run: Filter, factors: list[float], prior: float, passes: int) -> None:
    record = rigid_record(np.random.default_rng(0), 3.0, 20.0)
    how = (
        FilterSettings(passes=passes)
        if passes < 3
        else FilterSettings(euler_step, Exponential(), passes=passes)
    )
    assert_finite(run(record, compile_model(rigid_start(factors, 10.0**prior), online=True), how))


@pytest.mark.parametrize("run", [run_ekf, pytest.param(run_ukf, marks=pytest.mark.slow)])
@settings(max_examples=6)
@given(beta=wild)
def test_wild_ballistic_coefficient(run: Filter, beta: float) -> None:
    assert_finite(
        run(
            ballistic_record(np.random.default_rng(0)),
            compile_model(ballistic_start(beta), online=True),
        )
    )


@pytest.mark.parametrize("run", FILTERS)
def test_divergence_keeps_the_last_sound_sample(run: Filter) -> None:
    # A start that is sound for a while: the unstable roots need some samples to leave the range of
    # numbers.
    record = rigid_record(np.random.default_rng(0), 4.0, 25.0)
    gone = [
        Channel.of(c.name, c.unit, np.where(record.time < 0.5, c.values, np.nan))
        for c in record.outputs
    ]
    blind = Record(record.time, record.inputs, tuple(gone))
    estimate = run(
        blind, compile_model(rigid_start([1.0, 1.0, 1.0, -3e4, 1.0, 1.0], 1e-3), online=True)
    )
    assert estimate.outcome in (Outcome.DIVERGED, Outcome.INDEFINITE)
    assert estimate.message.startswith("at ") and estimate.message.endswith(" s")
    assert_finite(estimate)
    assert estimate.history is not None
    last = int(np.searchsorted(record.time, float(estimate.message[3:-2]) - 1e-9)) - 1
    assert (5 if run is run_ekf else 0) < last < len(record) - 1
    tail = estimate.history.mean[:, last:]
    np.testing.assert_array_equal(tail, np.repeat(tail[:, :1], tail.shape[1], axis=1))
    assert not np.any(estimate.history.valid[:, last + 1 :])
    np.testing.assert_array_equal(estimate.values, tail[2:, 0])


def test_an_innovation_beyond_all_numbers_diverges() -> None:
    record = rigid_record(np.random.default_rng(0), 1.0, 20.0)
    channels = [
        Channel.of(c.name, c.unit, np.where(np.arange(len(record)) == 7, 1e180, c.values))
        for c in record.outputs
    ]
    for run in FILTERS:
        estimate = run(
            Record(record.time, record.inputs, tuple(channels)),
            compile_model(rigid_start(), online=True),
        )
        assert estimate.outcome is Outcome.DIVERGED and estimate.message == "at 0.35 s"
        assert_finite(estimate)


def test_kinds_of_breakdown() -> None:
    sound = np.eye(2)
    assert breakdown(np.zeros(2), sound) is None
    assert breakdown(np.array([0.0, np.nan]), sound) is Outcome.DIVERGED
    assert breakdown(np.zeros(2), np.diag([1.0, np.inf])) is Outcome.DIVERGED
    assert breakdown(np.zeros(2), sound, np.nan) is Outcome.DIVERGED
    assert breakdown(np.zeros(2), np.diag([1.0, -1e-9])) is Outcome.INDEFINITE
