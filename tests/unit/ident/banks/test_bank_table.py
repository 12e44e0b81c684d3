"""The pass by table against the pass by steps, sample by sample; what has no table is left to the
steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.banks.bank import bank_runs
from ident.banks.block_kernels import BankTrace, empty_trace, step_block_filter, table_block_filter
from ident.filters.ekf import FilterSettings
from ident.filters.one_record import Exponential, Taylor
from ident.filters.problem import FilterProblem
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.propagation import euler_step
from sim.record import Hold, Record
from tests import loes_problem as problem
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import rigid_record, rigid_start

GRID = np.array([0.0, 0.107, 0.12])
FIELDS = ("transition", "H", "HP", "S", "y")


def start_of(laid_out: FilterProblem, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return start, np.array(
        np.broadcast_to(laid_out.covariance, (start.shape[1], *laid_out.covariance.shape))
    )


@pytest.mark.sampled
@pytest.mark.parametrize(
    "density", [{}, {"q": 1e-6}, {"alpha": 1e-7, "q": 1e-6}], ids=["no noise", "one", "two"]
)
@pytest.mark.parametrize("max_step", [np.inf, 0.015])
@pytest.mark.parametrize("elsewhere", [False, True], ids=["about itself", "about a trajectory"])
def test_equal_to_the_steps(density: dict[str, float], max_step: float, elsewhere: bool) -> None:
    flown = problem.record(3, duration=2.4, gaps=True)
    system, settings = problem.system(flown, density=density), FilterSettings(max_step=max_step)
    laid_out, runs = bank_runs(flown, system, settings, fixed_values={"delay": GRID})
    nominal = (
        np.random.default_rng(1).normal(1.0, 0.1, (14, len(flown), 3)) * runs.start[:, None]
        if elsewhere
        else None
    )
    x, P = start_of(laid_out, runs.start)
    results, traces = [], []
    for prepare in (table_block_filter, step_block_filter):
        filter_next_block, trace = prepare(laid_out, settings, runs), empty_trace(laid_out, 3)
        assert filter_next_block is not None
        first = filter_next_block(0, 20, x, P, nominal, trace)
        results.append(
            filter_next_block(
                20, len(flown), first.mean[-1].T, first.covariance[-1], nominal, trace
            )
        )
        traces.append(trace)
    scale = np.sqrt(np.diagonal(results[1].covariance, axis1=2, axis2=3))
    np.testing.assert_allclose(
        results[0].mean / scale, results[1].mean / scale, rtol=1e-9, atol=1e-9
    )
    spread = scale[:, :, :, None] * scale[:, :, None, :]
    np.testing.assert_allclose(
        results[0].covariance / spread, results[1].covariance / spread, atol=1e-9
    )
    np.testing.assert_allclose(results[0].innovation, results[1].innovation, rtol=1e-8, atol=1e-10)
    assert_same_trace(*traces)


def assert_same_trace(found: BankTrace, expected: BankTrace) -> None:
    for name in FIELDS:
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(
            one, other, rtol=1e-8, atol=1e-10 * np.abs(other).max(), err_msg=name
        )


def test_an_input_that_acts_on_an_output() -> None:
    record = rigid_record(np.random.default_rng(1), 3.0, 25.0)
    system, settings = compile_model(rigid_start(1.1), online=True), FilterSettings()
    laid_out, runs = bank_runs(record, system, settings)
    x, P = start_of(laid_out, runs.start)
    found, expected = (
        prepare(laid_out, settings, runs) for prepare in (table_block_filter, step_block_filter)
    )
    assert found is not None and expected is not None
    one, other = found(0, len(record), x, P, None, None), expected(0, len(record), x, P, None, None)
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.innovation, other.innovation, rtol=1e-8, atol=1e-12)


def test_what_has_no_table() -> None:
    record, settings = rigid_record(np.random.default_rng(1), 2.0, 25.0), FilterSettings()
    model = rigid_start()

    def has_table(
        model: Model = model,
        record: Record = record,
        settings: FilterSettings = settings,
        held: dict[str, np.ndarray] | None = None,
    ) -> bool:
        system = compile_model(model, online=True)
        laid_out, runs = bank_runs(record, system, settings, fixed_values=held)
        return table_block_filter(laid_out, settings, runs) is not None

    assert has_table()
    assert not has_table(settings=FilterSettings(step=euler_step))
    assert not has_table(settings=FilterSettings(transition=Exponential()))
    assert not has_table(settings=FilterSettings(transition=Taylor(2)))
    assert not has_table(record=replace(record, hold=Hold.LINEAR))
    assert not has_table(held={"mass": np.array([9e4, 1e5])})
    assert has_table(held={"mass": np.array([1e5])})
    jump = model.with_effects(DerivativeJump())
    assert not has_table(
        model=jump.with_parameters(
            jump.parameters.hold(
                [n for n in jump.parameters.names if n.startswith("derivative-jump")]
            )
        )
    )


def test_a_parameter_that_wanders_has_no_table() -> None:
    record = record_of(np.random.default_rng(3), 40)
    for density, expected in (({"speed": 0.05}, True), ({"speed": 0.05, "force": 0.01}, False)):
        system, settings = compile_model(oscillator(density), online=True), FilterSettings()
        laid_out, runs = bank_runs(record, system, settings)
        assert (table_block_filter(laid_out, settings, runs) is not None) == expected
