"""Filters side by side in rows of runs against the stacked ones, which filterpy's hold; and no
run's numbers depend on the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest

from ident.banks import row_kernel
from ident.banks.bank import bank_runs, run_bank, run_pass
from ident.banks.row_kernel import BankHistory, BankPass
from ident.filters.ekf import FilterSettings
from ident.filters.one_record import Exponential
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise, System
from sim.effects.input_path.input_delay import InputDelay
from sim.record import Record
from tests import loes_problem
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import TRUE, rigid_record, rigid_start, with_losses

RUNS = 5


def rigid(*, gaps: bool = False) -> Record:
    record = rigid_record(np.random.default_rng(1), 4.0, 25.0)
    return with_losses(record) if gaps else record


def noisy(**density: float) -> Model:
    model = rigid_start(1.1)
    return model.with_noise(Noise(model.noise.measurement_std, density))


def delayed() -> System:
    model = rigid_start(1.1).with_effects(InputDelay("elevator"))
    return compile_model(
        model.with_parameters(model.parameters.hold(["input-delay.delay"])), online=True
    )


def two_outputs(model: Model) -> System:
    return compile_model(model, ["alpha", "q"], online=True)


Case = tuple[Record, Callable[[], System], FilterSettings, dict[str, np.ndarray]]
PLAIN: dict[str, np.ndarray] = {}
CASES: dict[str, Case] = {
    "three outputs": (
        rigid(),
        lambda: compile_model(rigid_start(1.1), online=True),
        FilterSettings(),
        PLAIN,
    ),
    "two outputs": (rigid(), lambda: two_outputs(rigid_start(1.1)), FilterSettings(), PLAIN),
    "gaps": (
        rigid(gaps=True),
        lambda: compile_model(rigid_start(1.1), online=True),
        FilterSettings(),
        PLAIN,
    ),
    "gaps in two": (
        rigid(gaps=True),
        lambda: two_outputs(rigid_start(1.1)),
        FilterSettings(),
        PLAIN,
    ),
    "noise on one state, sub-steps": (
        rigid(),
        lambda: two_outputs(noisy(q=1e-5)),
        FilterSettings(max_step=0.015),
        PLAIN,
    ),
    "noise on both": (
        rigid(),
        lambda: two_outputs(noisy(alpha=1e-6, q=1e-5)),
        FilterSettings(),
        PLAIN,
    ),
    "a delay of each run": (
        rigid(),
        delayed,
        FilterSettings(),
        {"input-delay.delay": np.linspace(0.0, 0.05, RUNS)},
    ),
    "feed-through of two inputs": (
        record_of(np.random.default_rng(3), 60, uneven=True, missing=True),
        lambda: compile_model(oscillator({"speed": 0.05}), online=True),
        FilterSettings(),
        PLAIN,
    ),
    "fourteen states": (
        loes_problem.record(3, duration=2.4),
        lambda: loes_problem.system(loes_problem.record(3)),
        FilterSettings(),
        PLAIN,
    ),
}


def measured(record: Record, system: System, count: int) -> np.ndarray:
    """Outputs of so many runs, ``(m, N, count)``."""
    z = record.output_array(system.output_names)[0]
    rng = np.random.default_rng(5)
    return z[:, :, None] + 0.1 * np.nanstd(z, axis=1)[:, None, None] * rng.standard_normal(
        (*z.shape, count)
    )


def both(case: Case, keep: bool) -> tuple[BankPass, BankPass]:
    record, make, settings, held = case
    system = make()
    problem, runs = bank_runs(
        record, system, settings, z=measured(record, system, RUNS), fixed_values=held
    )
    found, expected = (
        run_pass(problem, settings, runs, keep, in_rows=rows) for rows in (True, False)
    )
    assert row_kernel.run_pass_in_rows(problem, settings, runs, False) is not None, (
        "there is a table"
    )
    return found, expected


def assert_near(found: BankPass, expected: BankPass) -> None:
    sigma = np.sqrt(np.diagonal(expected.covariance, axis1=1, axis2=2))
    np.testing.assert_array_equal(found.sound, expected.sound)
    np.testing.assert_allclose((found.mean - expected.mean) / sigma.T, 0.0, atol=1e-8)
    np.testing.assert_allclose(
        (found.covariance - expected.covariance) / (sigma[:, :, None] * sigma[:, None]),
        0.0,
        atol=1e-8,
    )
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, rtol=1e-10)
    np.testing.assert_allclose(found.nis, expected.nis, rtol=1e-7, atol=1e-9)
    for field in fields(BankHistory) if expected.history is not None else ():
        one, other = getattr(found.history, field.name), getattr(expected.history, field.name)
        np.testing.assert_allclose(
            one, other, rtol=1e-8, atol=1e-9 * np.abs(other).max(), err_msg=field.name
        )


@pytest.mark.sampled
@pytest.mark.parametrize("case", CASES)
def test_equal_to_the_stacked_filters(case: str) -> None:
    found, expected = both(CASES[case], True)
    assert np.all(expected.sound)
    assert_near(found, expected)
    P = found.covariance
    np.testing.assert_array_equal(P, P.transpose(0, 2, 1))
    size = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # Of fourteen states one direction is known exactly: its eigenvalue is the rounding of the
    # others, of the order of one.
    assert np.linalg.eigvalsh(P / (size[:, :, None] * size[:, None])).min() > -1e-14


@pytest.mark.sampled
@pytest.mark.parametrize("passes", [1, 4])
def test_no_run_depends_on_the_others(passes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    record, system, settings = (
        rigid(gaps=True),
        two_outputs(noisy(q=1e-5)),
        FilterSettings(passes=passes),
    )
    z = measured(record, system, 37)
    whole = run_bank(record, system, settings, z=z)
    monkeypatch.setattr(row_kernel, "_MOST_COVARIANCE_ENTRIES", 700)  # eleven runs at once
    for chosen in (
        np.arange(37),
        np.array([0]),
        np.array([36]),
        np.arange(3, 20),
        np.array([7, 30]),
    ):
        some = run_bank(record, system, settings, z=z[:, :, chosen])
        for name in ("mean", "log_likelihood", "nis", "sound", "iterations"):
            np.testing.assert_array_equal(
                getattr(some, name), getattr(whole, name)[..., chosen], err_msg=name
            )
        np.testing.assert_array_equal(some.covariance, whole.covariance[chosen])


@pytest.mark.parametrize("at", [0, 31, 32, 45, 100])
def test_a_run_that_breaks_down_keeps_its_last_sound_sample(at: int) -> None:
    record, system, settings = rigid(), two_outputs(rigid_start(1.1)), FilterSettings()
    z = measured(record, system, RUNS)
    z[0, at, 2] = 1e180
    problem, runs = bank_runs(record, system, settings, z=z)
    found, expected = (
        run_pass(problem, settings, runs, True, in_rows=rows) for rows in (True, False)
    )
    np.testing.assert_array_equal(found.sound, np.arange(RUNS) != 2)
    assert_near(found, expected)
    alone = run_pass(problem, settings, runs.select(np.array([0, 1, 3, 4])), True, in_rows=True)
    np.testing.assert_array_equal(found.mean[:, found.sound], alone.mean)
    np.testing.assert_array_equal(found.covariance[found.sound], alone.covariance)
    assert (
        found.history is not None
        and np.all(np.isfinite(found.history.mean))
        and np.all(np.isfinite(found.history.std))
    )


def test_starts_and_covariances_of_each_run() -> None:
    record, system = rigid(), two_outputs(rigid_start())
    rng = np.random.default_rng(4)
    z, start = (
        measured(record, system, RUNS),
        np.concatenate([np.zeros((2, RUNS)), TRUE[:, None] * rng.uniform(0.8, 1.2, (6, RUNS))]),
    )
    priors = np.concatenate(
        [np.full((RUNS, 2), 0.01), 0.3 * np.abs(TRUE) * rng.uniform(0.5, 1.0, (RUNS, 6))], axis=1
    )
    covariance = priors[:, :, None] ** 2 * np.eye(8)
    whole = run_bank(record, system, z=z, start=start, covariance=covariance)
    problem, runs = bank_runs(record, system, FilterSettings(), z=z, start=start)
    assert_near(
        BankPass(whole.mean, whole.covariance, whole.log_likelihood, whole.nis, whole.sound, None),
        run_pass(replace(problem, covariance=covariance), FilterSettings(), runs, False),
    )


def test_what_has_no_table_is_filtered_all_the_same() -> None:
    record, system, settings = (
        rigid(),
        two_outputs(rigid_start(1.1)),
        FilterSettings(transition=Exponential()),
    )
    problem, runs = bank_runs(record, system, settings, z=measured(record, system, RUNS))
    assert row_kernel.run_pass_in_rows(problem, settings, runs, False) is None
    found = run_pass(problem, settings, runs, False, in_rows=True)
    np.testing.assert_array_equal(found.mean, run_pass(problem, settings, runs, False).mean)
