"""The filter of one record by its table against filterpy's, every part of the history; what has no
table is left to filterpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest

from ident.estimate import Estimate, FilterHistory, Outcome
from ident.filters import ekf
from ident.filters.ekf import FilterSettings, filter_by_complex_step, filter_by_table, run_ekf
from ident.filters.one_record import Exponential, Taylor
from ident.filters.problem import FilterProblem, filter_problem
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise, System
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.propagation import euler_step
from sim.record import Hold, Record
from tests import loes_problem
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import UNSTABLE, rigid_record, rigid_start, with_losses


def held(model: Model, prefix: str) -> Model:
    return model.with_parameters(
        model.parameters.hold([name for name in model.parameters.names if name.startswith(prefix)])
    )


def noisy_rigid() -> Model:
    model = rigid_start()
    return model.with_noise(Noise(model.noise.measurement_std, {"alpha": 1e-6, "q": 1e-5}))


def two_outputs(model: Model) -> System:
    """With outputs that are states: their slopes never change."""
    return compile_model(model, ["alpha", "q"], online=True)


def online() -> System:
    return compile_model(rigid_start(), online=True)


def fourteen() -> System:
    return loes_problem.system(loes_problem.record(3))


def by_table(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    found = filter_by_table(problem, settings, start, nominal)
    assert found is not None
    return found


CASES: dict[str, tuple[Callable[[], Record], Callable[[], System], FilterSettings]] = {
    "rigid": (lambda: rigid_record(np.random.default_rng(1)), online, FilterSettings()),
    "two outputs": (
        lambda: rigid_record(np.random.default_rng(2)),
        lambda: two_outputs(rigid_start()),
        FilterSettings(),
    ),
    "lost samples": (
        lambda: with_losses(rigid_record(np.random.default_rng(3))),
        lambda: two_outputs(rigid_start()),
        FilterSettings(),
    ),
    "lost, nz too": (
        lambda: with_losses(rigid_record(np.random.default_rng(4))),
        online,
        FilterSettings(),
    ),
    "sub-steps": (
        lambda: rigid_record(np.random.default_rng(5)),
        lambda: two_outputs(noisy_rigid()),
        FilterSettings(max_step=0.007),
    ),
    "process noise": (
        lambda: rigid_record(np.random.default_rng(6)),
        lambda: compile_model(noisy_rigid(), online=True),
        FilterSettings(),
    ),
    "Euler": (
        lambda: rigid_record(np.random.default_rng(8)),
        lambda: two_outputs(noisy_rigid()),
        FilterSettings(euler_step, Taylor(2)),
    ),
    "three passes": (
        lambda: rigid_record(np.random.default_rng(9)),
        lambda: two_outputs(rigid_start()),
        FilterSettings(passes=3),
    ),
    "delay": (
        lambda: rigid_record(np.random.default_rng(10)),
        lambda: two_outputs(
            held(
                rigid_start()
                .with_effects(InputDelay("elevator"))
                .with_values({"input-delay.delay": 0.013}),
                "input-delay",
            )
        ),
        FilterSettings(),
    ),
    "sensor scale": (
        lambda: rigid_record(np.random.default_rng(11)),
        lambda: two_outputs(held(rigid_start().with_effects(SensorScale("alpha")), "sensor-scale")),
        FilterSettings(),
    ),
    "walking force": (
        lambda: record_of(np.random.default_rng(12), 60, uneven=True, missing=True),
        lambda: compile_model(oscillator({"speed": 0.05, "force": 0.01}), online=True),
        FilterSettings(),
    ),
    "fourteen states": (
        lambda: loes_problem.record(3, duration=2.4, gaps=True),
        fourteen,
        FilterSettings(),
    ),
}


def assert_equal(found: Estimate, expected: Estimate) -> None:
    assert (
        found.method,
        found.names,
        found.units,
        found.outcome,
        found.message,
        found.iterations,
    ) == (
        expected.method,
        expected.names,
        expected.units,
        expected.outcome,
        expected.message,
        expected.iterations,
    )
    assert found.history is not None and expected.history is not None
    np.testing.assert_allclose((found.values - expected.values) / expected.std, 0.0, atol=1e-9)
    np.testing.assert_allclose(
        found.covariance / np.outer(expected.std, expected.std), expected.correlation, atol=1e-9
    )
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-11)
    np.testing.assert_allclose(found.fitted[0], expected.fitted[0], rtol=1e-9, atol=1e-11)
    for field in fields(FilterHistory):
        one, other = getattr(found.history, field.name), getattr(expected.history, field.name)
        if field.name in ("time", "names", "valid", "degrees"):
            np.testing.assert_array_equal(one, other)
        elif field.name in ("covariance", "predicted_covariance"):
            spread = np.sqrt(np.einsum("kii,kjj->kij", other, other))
            np.testing.assert_allclose(
                (one - other) / np.where(spread > 0, spread, 1.0),
                0.0,
                atol=1e-9,
                err_msg=field.name,
            )
        else:
            np.testing.assert_allclose(
                one, other, rtol=1e-8, atol=1e-11 * np.abs(other).max(), err_msg=field.name
            )


@pytest.mark.sampled
@pytest.mark.parametrize("case", CASES)
def test_equal_to_filterpy(case: str) -> None:
    make_record, make_system, settings = CASES[case]
    record, system = make_record(), make_system()
    found = run_ekf(record, system, settings, by=by_table)
    assert_equal(found, run_ekf(record, system, settings, by=filter_by_complex_step))
    assert found.history is not None
    for P in (found.history.covariance, found.history.predicted_covariance):
        np.testing.assert_array_equal(P, P.transpose(0, 2, 1))
        size = np.sqrt(np.einsum("kii,kjj->kij", P, P))
        assert np.linalg.eigvalsh(P / size).min() > -1e-14


@pytest.mark.sampled
@pytest.mark.parametrize("losses", [False, True])
@pytest.mark.parametrize("max_step", [np.inf, 0.007])
def test_equal_about_a_trajectory(losses: bool, max_step: float) -> None:
    record = rigid_record(np.random.default_rng(1))
    record, system = (
        with_losses(record) if losses else record,
        compile_model(noisy_rigid(), online=True),
    )
    problem, settings = filter_problem(record, system, max_step), FilterSettings(max_step=max_step)
    nominal = problem.start[:, None] * np.random.default_rng(2).normal(1.0, 0.1, (8, len(record)))
    nominal[:2] = np.random.default_rng(3).normal(0.0, 0.02, (2, len(record)))
    found = filter_by_table(problem, settings, nominal=nominal)
    assert found is not None
    assert_equal(found, filter_by_complex_step(problem, settings, nominal=nominal))
    elsewhere = filter_by_table(problem, settings)
    assert (
        elsewhere is not None
        and np.max(np.abs(found.values - elsewhere.values) / elsewhere.std) > 0.1
    ), "the trajectory matters"


def test_an_aircraft_that_runs_away_keeps_its_covariance() -> None:
    record = rigid_record(np.random.default_rng(1), 8.0, 100.0, UNSTABLE)
    system = two_outputs(rigid_start(values=UNSTABLE))
    found = run_ekf(record, system, by=by_table)
    assert_equal(found, run_ekf(record, system, by=filter_by_complex_step))


def test_equations_without_a_table_go_by_complex_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    record, problem_of = rigid_record(np.random.default_rng(1), 2.0, 25.0), filter_problem
    usual = compile_model(rigid_start(), online=True)
    jump = compile_model(
        held(rigid_start().with_effects(DerivativeJump()), "derivative-jump"), online=True
    )
    others = [
        (record, usual, FilterSettings(transition=Exponential())),
        (record, usual, FilterSettings(transition=Taylor(4))),
        (replace(record, hold=Hold.LINEAR), usual, FilterSettings()),
        (record, jump, FilterSettings()),
    ]
    for flown, system, settings in others:
        assert filter_by_table(problem_of(flown, system, np.inf), settings) is None
    calls: list[int] = []

    def counted(*arguments: object) -> object:
        calls.append(1)
        return by_complex_step(*arguments)  # type: ignore[arg-type]

    by_complex_step = ekf._by_complex_step
    monkeypatch.setattr(ekf, "_by_complex_step", counted)
    for flown, system, settings in others:
        assert run_ekf(flown, system, settings).outcome is Outcome.CONVERGED
    assert len(calls) == len(others)
    assert run_ekf(record, usual).outcome is Outcome.CONVERGED and len(calls) == len(others), (
        "the usual one goes by its table"
    )


def test_a_breakdown_is_left_to_filterpy() -> None:
    record = rigid_record(np.random.default_rng(1), 2.0, 25.0)
    channels = tuple(
        replace(c, values=np.where(np.arange(len(record)) == 7, 1e180, c.values))
        for c in record.outputs
    )
    problem = filter_problem(
        replace(record, outputs=channels), compile_model(rigid_start(), online=True), np.inf
    )
    assert filter_by_table(problem, FilterSettings()) is None
