"""The batched filter equals the single one, run by run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.banks.bank import BankEstimate, run_bank
from ident.estimate import Outcome
from ident.filters.ekf import FilterSettings, filter_by_filterpy, run_ekf
from ident.filters.one_record import Exponential, Taylor
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import ModelError
from sim.propagation import euler_step
from sim.record import Channel, Hold, Record
from tests.bases import rigid_flight, rigid_model
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import FREE, TRUE, noisy, rigid_record, rigid_start

OUTPUTS = ("alpha", "q", "nz")


def holed(record: Record, rng: np.random.Generator) -> Record:
    """The record with a third of its samples missing, all channels for a while, and some rows left
    out.
    """
    outputs = []
    for channel in record.outputs:
        values = np.where(rng.random(len(record)) < 0.3, np.nan, channel.values)
        values[40:50] = np.nan
        outputs.append(Channel.of(channel.name, channel.unit, values))
    kept = np.sort(rng.permutation(len(record))[: len(record) * 3 // 4])
    cut = [
        tuple(Channel.of(c.name, c.unit, np.where(c.valid, c.values, np.nan)[kept]) for c in group)
        for group in (record.inputs, outputs)
    ]
    return Record(record.time[kept], cut[0], cut[1], record.hold)


def assert_run_equals(
    bank: BankEstimate, run: int, record: Record, model: Model, how: FilterSettings
) -> None:
    single = run_ekf(record, compile_model(model, online=True), how, by=filter_by_filterpy)
    history = single.history
    assert history is not None
    assert (
        bank.history is not None
        and bank.history_std is not None
        and bank.innovation is not None
        and bank.innovation_std is not None
    )
    assert bank.sound[run] == (single.outcome is Outcome.CONVERGED)
    assert bank.iterations[run] == single.iterations
    n_x = len(history.names) - len(single.names)
    scale = np.maximum(history.std.max(axis=1, keepdims=True), 1e-12)
    small = 1e-9
    assert np.max(np.abs(bank.history[:, :, run] - history.mean) / scale) < small
    assert np.max(np.abs(bank.history_std[:, :, run] - history.std) / scale) < small
    np.testing.assert_allclose(bank.mean[n_x:, run], single.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(bank.std[n_x:, run], single.std, rtol=1e-9)
    np.testing.assert_allclose(
        bank.covariance[run][n_x:, n_x:] / np.outer(single.std, single.std),
        single.correlation,
        atol=1e-8,
    )
    np.testing.assert_allclose(
        bank.innovation[:, :, run], history.innovation, rtol=1e-8, atol=1e-10
    )
    np.testing.assert_allclose(bank.innovation_std[:, :, run], history.innovation_std, rtol=1e-9)
    np.testing.assert_allclose(bank.nis[:, run], history.nis, rtol=1e-7, atol=1e-9)
    assert bank.log_likelihood[run] == pytest.approx(single.log_likelihood, rel=1e-9)


@pytest.mark.long
@settings(max_examples=3)
@given(
    seed=st.integers(0, 10**6),
    passes=st.integers(1, 3),
    linear=st.booleans(),
    exponential=st.booleans(),
)
def test_starts_that_differ(seed: int, passes: int, linear: bool, exponential: bool) -> None:
    rng = np.random.default_rng(seed)
    record = holed(
        replace(rigid_record(rng, 4.0, 25.0), hold=Hold.LINEAR if linear else Hold.PREVIOUS), rng
    )
    how = FilterSettings(
        transition=Exponential() if exponential else Taylor(3), max_step=0.03, passes=passes
    )
    factors = rng.uniform(0.7, 1.3, (3, 6))
    start = np.concatenate([np.zeros((2, 3)), TRUE[:, None] * factors.T])
    bank = run_bank(record, compile_model(rigid_start(), online=True), how, start=start, keep=True)
    for run in range(3):
        assert_run_equals(bank, run, record, rigid_start(factors[run]), how)


@settings(max_examples=2)
@given(seed=st.integers(0, 10**6))
def test_measurements_that_differ(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, flight = rigid_model(), rigid_flight(4.0, 25.0)
    gaps = holed(noisy(model, flight, rng), rng)
    valid = gaps.output_array(OUTPUTS)[1]
    z = rng.normal(0.0, 0.02, (3, len(gaps), 2))
    how = FilterSettings(passes=2)
    bank = run_bank(gaps, compile_model(rigid_start(), online=True), how, z=z, keep=True)
    for run in range(2):
        channels = tuple(
            Channel.of(name, "1", np.where(valid[i], z[i, :, run], np.nan))
            for i, name in enumerate(OUTPUTS)
        )
        assert_run_equals(bank, run, replace(gaps, outputs=channels), rigid_start(), how)


@pytest.mark.parametrize("passes", [1, 4])
def test_delays_that_differ(passes: int) -> None:
    record = rigid_record(np.random.default_rng(1), 4.0, 25.0)
    model = rigid_start(1.1).with_effects(InputDelay("elevator"))
    model = model.with_parameters(model.parameters.hold(["input-delay.delay"]))
    delays, how = np.array([0.0, 0.013, 0.11]), FilterSettings(max_step=0.02, passes=passes)
    bank = run_bank(
        record,
        compile_model(model, online=True),
        how,
        fixed_values={"input-delay.delay": delays},
        keep=True,
    )
    assert np.argmax(bank.log_likelihood) == 0
    for run, delay in enumerate(delays):
        assert_run_equals(
            bank, run, record, model.with_values({"input-delay.delay": float(delay)}), how
        )


def test_process_noise_and_euler() -> None:
    density = {"position": 0.002, "speed": 0.05, "force": 0.01}
    record = record_of(np.random.default_rng(3), 40, uneven=True, missing=True, absent=("mixed",))
    how = FilterSettings(euler_step, Exponential(), 0.04)
    bank = run_bank(record, compile_model(oscillator(density), online=True), how, keep=True)
    assert_run_equals(bank, 0, record, oscillator(density), how)


def test_each_run_stops_by_itself() -> None:
    record = rigid_record(np.random.default_rng(2), 4.0, 25.0)
    how, factors = FilterSettings(passes=6), np.array([1.0, 1.4])
    start = np.concatenate([np.zeros((2, 2)), TRUE[:, None] * factors])
    bank = run_bank(record, compile_model(rigid_start(), online=True), how, start=start)
    assert 2 <= bank.iterations[0] < bank.iterations[1] < 6
    assert bank.history is None and bank.innovation is None


def test_a_run_that_breaks_down_leaves_the_others_alone() -> None:
    record = rigid_record(np.random.default_rng(4), 4.0, 25.0)
    model, how = rigid_start(), FilterSettings(passes=2)
    wild = np.array([2e8, -14.7, 0.435, -3e8, 2e9, -2.578])
    start = np.concatenate([np.zeros((2, 2)), np.stack([wild, TRUE], 1)])
    bank = run_bank(record, compile_model(model, online=True), how, start=start, keep=True)
    np.testing.assert_array_equal(bank.sound, [False, True])
    assert bank.log_likelihood[0] == -np.inf and bank.iterations[0] == 1
    assert bank.history is not None and bank.history_std is not None and bank.innovation is not None
    assert all(
        np.all(np.isfinite(array))
        for array in (
            bank.mean,
            bank.covariance,
            bank.nis,
            bank.history,
            bank.history_std,
            bank.innovation,
        )
    )
    alone = run_bank(record, compile_model(model, online=True), how, start=start[:, 1])
    np.testing.assert_allclose(bank.mean[:, 1], alone.mean[:, 0], rtol=1e-12)
    single = run_ekf(
        record,
        compile_model(model.with_values(dict(zip(FREE, wild, strict=True))), online=True),
        how,
    )
    # which of the two comes first is a matter of rounding
    assert single.outcome in (Outcome.DIVERGED, Outcome.INDEFINITE)


def test_names_what_does_not_fit() -> None:
    record, system = (
        rigid_record(np.random.default_rng(5), 2.0, 25.0),
        compile_model(rigid_start(), online=True),
    )
    with pytest.raises(ModelError, match="bank, CL_q: the parameter is free"):
        run_bank(record, system, fixed_values={"CL_q": np.zeros(2)})
    with pytest.raises(ModelError, match="numbers of runs differ"):
        run_bank(record, system, fixed_values={"mass": np.full(3, 1e5)}, start=np.zeros((8, 2)))
