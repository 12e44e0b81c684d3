"""The bank of delays: equal to separate filterpy filters, weights without overflow, a refined delay
that is the true one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.banks.bank import run_bank
from ident.banks.delays import (
    DELAYS,
    DelayBank,
    likelihood_weights,
    parabola_vertex,
    run_delay_bank,
)
from ident.filters.ekf import run_ekf
from sim.errors import ModelError
from tests import loes_problem as problem
from tests.bases import LOES_VALUES


@pytest.mark.parametrize("gaps", [False, True])
def test_bank_is_nine_filterpy_filters(gaps: bool) -> None:
    flown = problem.record(1, duration=2.4, gaps=gaps)
    system = problem.system(flown)
    bank = run_bank(flown, system, fixed_values={"delay": np.array(DELAYS)})
    assert len(bank.names) == 14
    for run, delay in enumerate(DELAYS):
        alone = run_ekf(
            flown, replace(system, parameters=system.parameters.with_values({"delay": delay}))
        )
        assert alone.history is not None
        scale = alone.history.std[:, -1]
        np.testing.assert_allclose(
            bank.mean[:, run] / scale, alone.history.mean[:, -1] / scale, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(bank.std[:, run], scale, rtol=1e-9)
        assert bank.log_likelihood[run] == pytest.approx(alone.log_likelihood, rel=1e-9)


@cache
def from_near() -> DelayBank:
    """The bank of record 2, started 15 % off."""
    flown = problem.record(2)
    return run_delay_bank(flown, problem.system(flown))


def test_refined_delay_and_parameters_are_the_true_ones() -> None:
    flown, found = problem.record(2), from_near()
    assert found.most_likely in (0.1, 0.125) and not found.at_edge
    assert 0.0 < found.refined_std < 0.006
    assert abs(found.refined - problem.TRUE_DELAY) < 4.0 * found.refined_std
    estimate = found.estimate
    assert estimate.names[-1] == "delay" and estimate.value("delay") == found.refined
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        assert abs(estimate.value(name) - LOES_VALUES[name]) < 4.0 * estimate.sigma(name), name
    assert np.linalg.eigvalsh(estimate.correlation).min() > 0
    assert estimate.history is not None and estimate.history.mean.shape == (14, len(flown))
    np.testing.assert_allclose(found.weights @ found.delays, found.weighted_mean)


FAR_STARTS = (
    {"M_alpha": 2.5, "M_delta": 2.0},
    {"M_q": 0.3},
    {"inv_tau": 0.3},
    {"M_delta": -1.0},
    {"M_alpha": 0.2},
)


@pytest.mark.sampled
@pytest.mark.parametrize("factors", FAR_STARTS, ids=lambda factors: ", ".join(factors))
def test_the_result_hangs_on_no_start_that_is_far_off(factors: dict[str, float]) -> None:
    near, flown = from_near(), problem.record(2)
    assert near.contradicted == () and near.estimate.message == ""
    start = problem.system(flown)
    priors = {
        name: abs(factor) * start.parameters[name].prior_std for name, factor in factors.items()
    }
    parameters = start.parameters.with_values(
        {name: factor * start.parameters[name].value for name, factor in factors.items()}
    ).with_prior(priors)
    far = run_delay_bank(flown, replace(start, parameters=parameters))
    assert far.contradicted == () and not far.at_edge
    assert abs(far.refined - near.refined) < near.refined_std
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        assert abs(far.estimate.value(name) - near.estimate.value(name)) < max(
            near.estimate.sigma(name), far.estimate.sigma(name)
        ), name


def test_priors_that_are_to_stand_are_told_where_the_record_contradicts_them() -> None:
    flown = problem.record(2)
    start = problem.system(flown)
    low = start.parameters["M_q"].value * 0.3
    start = replace(
        start,
        parameters=start.parameters.with_values({"M_q": low}).with_prior({"M_q": 0.25 * abs(low)}),
    )
    held = run_delay_bank(flown, start, widenings=0)
    named = dict(held.contradicted)
    assert (
        named["M_q"]
        == pytest.approx((held.estimate.value("M_q") - low) / (0.25 * abs(low)), rel=0.1)
        and named["M_q"] < -3.0
    )
    assert "M_q by" in held.estimate.message and "start again" in held.estimate.message


def test_a_delay_outside_the_grid_is_told() -> None:
    flown = problem.record(3, duration=5.0)
    found = run_delay_bank(flown, problem.system(flown), (0.0, 0.02, 0.04))
    assert (
        found.at_edge
        and found.most_likely == 0.04
        and found.refined == pytest.approx(0.04)
        and found.refined_std == 0.0
    )
    assert "delay" not in found.estimate.names


def test_wrong_grids_and_a_free_delay_are_refused() -> None:
    flown = problem.record(4, duration=2.0)
    system = problem.system(flown)
    for grid in ((0.0, 0.1), (0.0, 0.1, 0.1)):
        with pytest.raises(ModelError, match="three or more in order"):
            run_delay_bank(flown, system, grid)
    with pytest.raises(ModelError, match="M_q"):
        run_delay_bank(flown, system, name="M_q")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9), st.floats(-1e8, 1e8))
def test_weights_sum_to_one_and_do_not_depend_on_a_common_factor(
    values: list[float], shift: float
) -> None:
    log = np.array(values)
    weights = likelihood_weights(log)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[np.argmax(log)] == weights.max()
    np.testing.assert_allclose(likelihood_weights(log + shift), weights, atol=1e-6)


def test_weights_of_broken_filters() -> None:
    np.testing.assert_array_equal(likelihood_weights(np.array([-np.inf, 3.0])), [0.0, 1.0])
    np.testing.assert_array_equal(likelihood_weights(np.full(4, -np.inf)), np.full(4, 0.25))


@given(st.floats(0.5, 2.0), st.floats(-3.0, 3.0), st.floats(0.1, 9.0))
def test_vertex_of_a_parabola(width: float, top: float, curvature: float) -> None:
    x = np.array([-1.0, 0.2, 0.2 + width])
    got = parabola_vertex(x, 5.0 - 0.5 * curvature * (x - top) ** 2)
    assert got == pytest.approx((top, curvature), rel=1e-6, abs=1e-9)
    assert parabola_vertex(x, x**2)[1] == 0.0


@pytest.mark.parametrize(
    "y", [[1.0, 0.04, 1.44], [2.0, 2.0, 2.0], [1.0, 3.0, 6.0], [0.0, np.nan, 1.0]]
)
def test_three_points_without_a_maximum_have_their_middle_for_a_vertex(y: list[float]) -> None:
    """Open upwards, a straight line, or not known: no curvature."""
    assert parabola_vertex(np.array([-1.0, 0.2, 1.2]), np.array(y)) == (0.2, 0.0)
