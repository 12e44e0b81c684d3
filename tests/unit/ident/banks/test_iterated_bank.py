"""The iterated bank against the single iterated filter and its smoother."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.banks.bank import bank_runs, run_pass
from ident.banks.block_kernels import empty_trace
from ident.banks.engines import run_iterated_bank, smoothed
from ident.filters.ekf import FilterSettings, run_ekf, run_iterated_ekf
from ident.filters.smoother import smooth
from tests import loes_problem as problem

GRID = np.array([0.1, 0.12])


@pytest.mark.parametrize("max_step", [float("inf"), 0.025])
def test_smoothed_means_are_those_of_the_fixed_interval_smoother(max_step: float) -> None:
    flown = problem.record(5, duration=3.0, gaps=True)
    system, settings = problem.system(flown), FilterSettings(max_step=max_step)
    laid_out, runs = bank_runs(flown, system, settings, fixed_values={"delay": GRID})
    trace = empty_trace(laid_out, 2)
    run_pass(laid_out, settings, runs, False, trace=trace)
    got = smoothed(trace)
    for run, delay in enumerate(GRID):
        history = run_ekf(
            flown,
            replace(system, parameters=system.parameters.with_values({"delay": delay})),
            settings,
        ).history
        assert history is not None
        expected = smooth(history)
        np.testing.assert_allclose(
            got[:, :, run] / history.std[:, -1:],
            expected.mean / history.std[:, -1:],
            rtol=1e-6,
            atol=1e-5,
        )


@pytest.mark.long
def test_settles_where_the_single_iterated_filter_does() -> None:
    flown = problem.record(6, duration=4.0)
    system = problem.system(flown)
    bank, trajectories = run_iterated_bank(flown, system, fixed_values={"delay": GRID})
    assert bank.sound.all() and trajectories.shape == (14, len(flown), 2)
    for run, delay in enumerate(GRID):
        alone = run_iterated_ekf(
            flown, replace(system, parameters=system.parameters.with_values({"delay": delay}))
        )
        np.testing.assert_allclose((bank.mean[3:, run] - alone.values) / alone.std, 0.0, atol=0.02)
        assert bank.log_likelihood[run] == pytest.approx(alone.log_likelihood, abs=0.01)


def test_does_not_depend_on_the_start_of_the_linearisation() -> None:
    flown = problem.record(7, duration=4.0)
    system = problem.system(flown)
    cold, trajectories = run_iterated_bank(flown, system, fixed_values={"delay": GRID})
    warm, _ = run_iterated_bank(
        flown, system, fixed_values={"delay": GRID}, nominal=trajectories[:, :, :1]
    )
    assert warm.iterations[0] < cold.iterations[0]
    np.testing.assert_allclose((warm.mean - cold.mean) / cold.std, 0.0, atol=0.02)


def test_a_limit_of_passes_leaves_no_run_sound() -> None:
    flown = problem.record(8, duration=3.0)
    bank, _ = run_iterated_bank(
        flown, problem.system(flown), fixed_values={"delay": GRID}, iterations=2
    )
    assert (
        not bank.sound.any()
        and np.all(bank.log_likelihood == -np.inf)
        and np.all(np.isfinite(bank.mean))
    )
