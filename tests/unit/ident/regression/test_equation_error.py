"""Equation error and the local polynomials it stands on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exam.coverage.independent_flights import flown
from ident.estimate import Outcome
from ident.regression.equation_error import RegressionSettings, run_equation_error
from ident.regression.state_histories import (
    half_width_by_cross_validation,
    rate_relations,
    smoothed,
    windows,
)
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.declaration.effect import ParameterSet
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import ModelError
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import model_from_constants
from tests.bases import RIGID_VALUES, ballistic_model, rigid_flight, rigid_model
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import FREE, TRUE, UNSTABLE, ballistic_record, noisy, rigid_record


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), degree=st.integers(1, 3), half=st.integers(3, 8))
def test_polynomials_are_met_exactly_whatever_the_sampling(
    seed: int, degree: int, half: int
) -> None:
    rng = np.random.default_rng(seed)
    time, valid = np.cumsum(rng.uniform(0.01, 0.03, 60)), rng.random(60) > 0.2
    coefficients = rng.normal(size=degree + 1)
    values = np.where(valid, np.polyval(coefficients, time), 99.0)
    fit = windows(time, valid, half, degree)
    assert np.any(fit.usable)
    np.testing.assert_allclose(
        np.sum(fit.value_weights * fit.gather(values), 1)[fit.usable],
        np.polyval(coefficients, time)[fit.usable],
        rtol=1e-7,
        atol=1e-7,
    )
    slope = np.polyval(np.polyder(coefficients), time)
    np.testing.assert_allclose(
        np.sum(fit.slope_weights * fit.gather(values), 1)[fit.usable],
        slope[fit.usable],
        rtol=1e-5,
        atol=1e-5,
    )
    np.testing.assert_array_equal(fit.slope_weights[~fit.usable], 0.0)


def test_windows_over_gaps_are_not_used_and_bridged_straight() -> None:
    time = np.concatenate([np.arange(20) * 0.1, 5.0 + np.arange(20) * 0.1])
    valid = np.ones(40, dtype=bool)
    valid[5:12] = False
    fit = windows(time, valid, 3, 2)
    # Three rows on either side of the middle of the hole, and those whose window holds the jump in
    # time.
    assert not np.any(fit.usable[7:10]) and not np.any(fit.usable[17:23])
    assert np.all(fit.usable[[0, 4, 13, 16, 23, 39]])
    values = np.where(valid, np.sin(time), 0.0)
    assert smoothed(time, values, valid, 3)[8] == pytest.approx(
        np.interp(time[8], time[[4, 12]], np.sin(time[[4, 12]]))
    )


def test_cross_validation_widens_with_noise() -> None:
    rng, time = np.random.default_rng(1), np.arange(300) * 0.02
    curve, valid = np.sin(3.0 * time), np.ones(300, dtype=bool)
    widths = [
        half_width_by_cross_validation(time, curve + std * rng.standard_normal(300), valid)
        for std in (1e-6, 0.01, 0.3)
    ]
    assert widths[0] < widths[1] < widths[2]
    noise = 0.1 * rng.standard_normal(300)
    half = half_width_by_cross_validation(time, curve + noise, valid)
    assert np.std(smoothed(time, curve + noise, valid, half) - curve) < 0.5 * np.std(noise)


@pytest.mark.parametrize("values", [RIGID_VALUES, UNSTABLE], ids=["stable", "unstable"])
def test_nearly_exact_data_give_the_truth_from_any_start(values: dict[str, float]) -> None:
    record = noisy(
        rigid_model(values),
        rigid_flight(6.0, 100.0),
        np.random.default_rng(2),
        scale=1e-4,
        offsets={"alpha": 0.02, "nz": -0.3},
    )
    start = (
        rigid_model(values)
        .with_values({name: -3.0 * values[name] for name in FREE})
        .with_biases(["alpha", "q", "nz"])
    )
    estimate = run_equation_error([record], compile_model(start))
    assert estimate.outcome is Outcome.CONVERGED and estimate.names == FREE
    truth = np.array([values[name] for name in FREE])
    np.testing.assert_allclose(estimate.values, truth, rtol=0.02)


@pytest.mark.long
def test_noisy_records_give_a_starter_with_a_sigma() -> None:
    system = compile_model(
        rigid_model()
        .with_values({name: 2.0 * RIGID_VALUES[name] for name in FREE})
        .with_biases(["alpha", "q", "nz"])
    )
    errors, stated = [], []
    for seed in range(8):
        record = rigid_record(np.random.default_rng(seed))
        estimate = run_equation_error([record], system)
        assert estimate.outcome is Outcome.CONVERGED
        errors.append(estimate.values - TRUE)
        stated.append(estimate.std)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms < [0.03, 1.5, 0.04, 0.02, 1.5, 0.05])
    ratio = rms / np.mean(stated, axis=0)
    assert np.all(ratio > 0.4) and np.all(ratio < 2.2)
    reference = fit_output_error([record], system)
    assert np.all(stated[-1] > reference.std)
    np.testing.assert_allclose(estimate.noise_std, reference.noise_std, rtol=0.35)


def test_several_records_and_holes() -> None:
    rng = np.random.default_rng(3)
    records = [
        noisy(rigid_model(), rigid_flight(d), rng, offsets=o)
        for d, o in ((4.0, {"alpha": 0.01}), (6.0, {"alpha": -0.02}))
    ]
    channels = []
    for channel in records[1].outputs:
        values = np.where(rng.random(len(channel.values)) < 0.1, np.nan, channel.values)
        values[120:150] = np.nan
        channels.append(Channel.of(channel.name, channel.unit, values))
    holed = replace(records[1], outputs=tuple(channels))
    system = compile_model(rigid_model().with_biases(["alpha", "q", "nz"]))
    both = run_equation_error([records[0], holed], system)
    assert both.outcome is Outcome.CONVERGED and [f.shape for f in both.fitted] == [
        (3, 201),
        (3, 301),
    ]
    assert np.max(np.abs(both.values - TRUE) / both.std) < 6.0
    assert np.all(both.std < run_equation_error([records[0]], system).std * 1.1)


def test_a_velocity_is_the_slope_of_its_altitude() -> None:
    system = compile_model(ballistic_model().with_values({"beta": 900.0}))
    assert rate_relations(system, np.arange(3.0)) == {"altitude": "velocity"}
    estimate = run_equation_error([ballistic_record(np.random.default_rng(4))], system)
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.values[0] == pytest.approx(2441.2, abs=5.0 * estimate.std[0])
    assert estimate.std[0] < 100.0
    assert rate_relations(compile_model(rigid_model()), np.arange(3.0)) == {}


def test_a_parameter_without_influence_is_not_identifiable() -> None:
    record = noisy(
        rigid_model(), replace(rigid_flight(3.0), u=np.zeros((1, 151))), np.random.default_rng(5)
    )
    estimate = run_equation_error([record], compile_model(rigid_model()))
    assert estimate.outcome is Outcome.NOT_IDENTIFIABLE
    assert np.all(np.isfinite(estimate.covariance)) and estimate.sigma("Cm_de") > 1e4


def test_bounds_are_kept() -> None:
    model = rigid_model()
    items = tuple(
        replace(item, bounds=(3.2, 4.0), value=3.5) if item.name == "CL_alpha" else item
        for item in model.parameters
    )
    estimate = run_equation_error(
        [rigid_record(np.random.default_rng(6))],
        compile_model(model.with_parameters(ParameterSet(items))),
    )
    assert estimate.outcome is Outcome.CONVERGED and estimate.value("CL_alpha") == 3.2


@settings(max_examples=15)
@given(powers=st.lists(st.floats(-3.0, 60.0), min_size=6, max_size=6))
def test_wild_starts_end_in_finite_numbers(powers: list[float]) -> None:
    start = rigid_model().with_values(
        {name: 10.0**power for name, power in zip(FREE, powers, strict=True)}
    )
    estimate = run_equation_error(
        [rigid_record(np.random.default_rng(7), 1.5, 20.0)],
        compile_model(start),
        RegressionSettings(iterations=5),
    )
    for array in (
        estimate.values,
        estimate.covariance,
        estimate.std,
        estimate.noise_std,
        np.array(estimate.log_likelihood),
        *estimate.fitted,
    ):
        assert np.all(np.isfinite(array))


def test_names_the_state_that_cannot_be_had() -> None:
    record, model = rigid_record(np.random.default_rng(1), 2.0), rigid_model()
    with pytest.raises(
        ModelError, match="state q is neither recorded nor the rate of a recorded state"
    ):
        run_equation_error([record.only(["alpha", "nz"])], compile_model(model))
    with pytest.raises(ModelError, match="state eta1 is neither"):
        run_equation_error([record], compile_model(model.with_effects(StructuralMode(1, (1,)))))
    with pytest.raises(ModelError, match="sensor-lag:q keeps a memory"):
        run_equation_error([record], compile_model(model.with_effects(SensorLag("q"))))
    with pytest.raises(ModelError, match="no parameter is free"):
        run_equation_error(
            [record], compile_model(model.with_parameters(model.parameters.hold(FREE)))
        )
    short: Record = record.window(0.0, 0.03)
    assert run_equation_error([short], compile_model(model)).outcome is Outcome.NOT_IDENTIFIABLE
    # The oscillator's position is measured, but under another name.
    with pytest.raises(ModelError, match="state position"):
        run_equation_error([record_of(np.random.default_rng(1))], compile_model(oscillator()))


def test_where_no_share_of_the_step_is_finite_it_has_not_converged() -> None:
    """Equations that hold at the start only: the step cannot be taken, but it is long."""
    system = compile_model(
        rigid_model().with_values({name: 1.3 * RIGID_VALUES[name] for name in FREE})
    )
    at = system.parameters.index("CL_alpha")
    start, f = float(system.parameters.values()[at]), system.f

    def f_at_start(t: Any, x: Any, u: Any, p: Any) -> list[Any]:
        return [
            row * np.where(np.abs(np.real(p[at]) - start) < 1e-9, 1.0, np.nan)
            for row in f(t, x, u, p)
        ]

    estimate = run_equation_error(
        [rigid_record(np.random.default_rng(1), 4.0, 25.0)], replace(system, f=f_at_start)
    )
    assert estimate.outcome is Outcome.MAX_ITERATIONS
    assert estimate.as_dict()["CL_alpha"] == start


def _errors(settings_of: RegressionSettings, runs: int) -> np.ndarray:
    """Errors in sigmas ``(runs, 6)`` on flights of another simulator, from 30 % wrong starts."""
    found = []
    for run in range(runs):
        flight = flown("rigid", "white", run)
        channels = {}
        for header, values in flight.columns.items():
            name, unit = header.removesuffix("]").split(" [")
            channels[name] = Channel.of(name, unit, values)
        record = Record(
            channels.pop("time").values,
            (channels.pop("elevator"),),
            tuple(channels.values()),
            Hold.PREVIOUS,
        )
        constants = {
            name: value for name, value in flight.vehicle.items() if isinstance(value, float)
        }
        model = model_from_constants("rigid", constants, flight.start).with_biases(
            ["alpha", "q", "nz"]
        )
        estimate = run_equation_error([record], compile_model(model), settings_of)
        assert estimate.outcome is Outcome.CONVERGED
        found.append(
            [
                (estimate.value(name) - value) / estimate.sigma(name)
                for name, value in flight.true.items()
            ]
        )
    return np.array(found)


@pytest.mark.long
def test_instruments_leave_no_bias_by_noise_and_an_honest_sigma() -> None:
    squares, instruments = (
        _errors(RegressionSettings(), 12),
        _errors(RegressionSettings(instruments=True), 12),
    )
    # The mean of 12 has a standard error of .3 sigma.
    assert np.max(np.abs(squares.mean(axis=0))) > 1.0
    assert np.max(np.abs(instruments.mean(axis=0))) < 0.8
    assert np.mean(np.abs(instruments) < 2.0) > 0.9
    rms = np.sqrt(np.mean(instruments**2, axis=0))
    assert np.all(rms > 0.4) and np.all(rms < 1.6)


@pytest.mark.long
def test_without_a_simulation_the_bias_of_least_squares_is_taken_off_and_stated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    squares = _errors(RegressionSettings(), 10)
    monkeypatch.setattr("ident.regression.equation_error.RUNAWAY_SCATTERS", 0.0)
    corrected = _errors(RegressionSettings(instruments=True), 10)
    assert np.linalg.norm(corrected.mean(axis=0)) < 0.5 * np.linalg.norm(squares.mean(axis=0))


def test_instruments_on_uneven_samples_with_missing_rows() -> None:
    rng = np.random.default_rng(8)
    whole = rigid_record(rng, 8.0)
    kept = np.sort(rng.choice(len(whole.time), len(whole.time) - 40, replace=False))
    kept = kept[(kept < 150) | (kept > 165)]
    inputs, outputs = (
        tuple(replace(c, values=c.values[kept], valid=c.valid[kept]) for c in group)
        for group in (whole.inputs, whole.outputs)
    )
    record = Record(whole.time[kept], inputs, outputs, whole.hold)
    system = compile_model(
        rigid_model()
        .with_values({name: 1.3 * RIGID_VALUES[name] for name in FREE})
        .with_biases(["alpha", "q", "nz"])
    )
    for instruments in (False, True):
        estimate = run_equation_error([record], system, RegressionSettings(instruments=instruments))
        assert estimate.outcome is Outcome.CONVERGED
        assert np.all(np.abs(estimate.values - TRUE) < 6.0 * estimate.std)


def test_even_windows_are_those_worked_out_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    time, valid = np.arange(200) * 0.02, np.ones(200, dtype=bool)
    for half, degree in ((2, 1), (8, 2), (23, 3)):
        at_once = windows(time, valid, half, degree)
        with monkeypatch.context() as patched:
            patched.setattr("ident.regression.state_histories._EVEN_SAMPLING_TOLERANCE", -1.0)
            each = windows(time, valid, half, degree)
        np.testing.assert_array_equal(at_once.first, each.first)
        np.testing.assert_allclose(at_once.value_weights, each.value_weights, atol=1e-11)
        np.testing.assert_allclose(at_once.slope_weights, each.slope_weights, atol=1e-9)
