"""The bank that is linearised anew on its way: the estimate of the whole record so far, whatever
the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.banks.delays import run_delay_bank
from ident.banks.online import (
    BankState,
    OnlineBank,
    Rows,
    advance,
    begin,
    changed_starts,
    online_bank,
    with_delays,
)
from ident.banks.relinearised import (
    Relinearised,
    advance_bank,
    bank_that_continues,
    informative_enough,
    joint_estimate,
    joint_moments,
    linearisation_due,
    linearise,
    with_fitting_grid,
)
from ident.estimate import Estimate
from sim.declaration.model import System
from sim.record import Record
from tests import loes_problem as problem

FACTORS = ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau")
HALF = 115  # rows: four and a half seconds, most of the maneuver


@pytest.fixture(scope="module")
def flown() -> tuple[Record, System, OnlineBank, Rows]:
    record = problem.record(3, duration=6.0)
    system = problem.system(record, share=1.3)
    bank = online_bank(system, 0.04)
    z, valid = record.output_array(bank.system.output_names)
    return (
        record,
        system,
        bank,
        Rows(record.time, record.input_array(bank.system.input_names), np.where(valid, z, np.nan)),
    )


def part(rows: Rows, first: int, last: int | None) -> Rows:
    return Rows(*(each[..., first:last] for each in rows))


@pytest.fixture(scope="module")
def states(flown: tuple[Record, System, OnlineBank, Rows]) -> list[BankState]:
    _, _, bank, rows = flown
    first = begin(bank, part(rows, 0, 1))
    return [first, *advance(bank, first, part(rows, 1, None))]


@pytest.fixture(scope="module")
def halfway(
    flown: tuple[Record, System, OnlineBank, Rows], states: list[BankState]
) -> Relinearised:
    record, system, bank, _ = flown
    so_far = record.window(0.0, float(record.time[HALF - 1]))
    found = linearise(so_far, system, bank, states[HALF - 1], changed_starts(bank, FACTORS))
    assert found is not None
    return found


def near(found: Estimate, refined: Estimate) -> None:
    """Half a sigma, for a mean over filters is no mode; the refinement's deviation of the delay is
    that of a curvature, here it is that of the likelihood's whole width, which tails make wider
    and, linearised at an earlier row, a fifth narrower at most."""
    np.testing.assert_allclose((found.values - refined.values) / refined.std, 0.0, atol=0.5)
    assert np.all(found.std > 0.8 * refined.std) and np.all(found.std < 1.5 * refined.std)


def test_it_begins_where_the_refinement_ends(
    flown: tuple[Record, System, OnlineBank, Rows], halfway: Relinearised
) -> None:
    record, system, _, _ = flown
    refined = run_delay_bank(record.window(0.0, float(record.time[HALF - 1])), system).estimate
    found = joint_estimate(halfway)
    assert found.names == refined.names
    near(found, refined)
    # wherever it was linearised first, it ends there
    np.testing.assert_array_equal(halfway.start_dependence, 0.0)


def test_row_by_row_it_stays_at_the_refinement_of_all_rows(
    flown: tuple[Record, System, OnlineBank, Rows], halfway: Relinearised
) -> None:
    record, system, _, rows = flown
    on = advance_bank(halfway, part(rows, HALF, None))
    assert len(on) == len(record) - HALF and on[-1].state.rows_seen == len(record)
    refined = run_delay_bank(record, system).estimate
    found = joint_estimate(with_fitting_grid(on[-1]))
    near(found, refined)
    assert not linearisation_due(halfway, FACTORS) and not linearisation_due(on[-1], FACTORS)
    assert linearisation_due(replace(on[-1], std=3.0 * halfway.std), FACTORS)
    assert linearisation_due(replace(on[-1], mean=halfway.mean + 2.0 * halfway.std), FACTORS)


def test_the_last_rows_go_on_where_they_hold_what_is_known_and_are_weighed_else(
    halfway: Relinearised,
) -> None:
    mean, covariance = joint_moments(halfway.bank, halfway.state)
    std = np.sqrt(np.diagonal(covariance))
    assert (
        bank_that_continues(None, halfway, FACTORS) is halfway
        and bank_that_continues(halfway, None, FACTORS) is halfway
    )
    assert bank_that_continues(None, None, FACTORS) is None
    as_sharp = replace(halfway, std=1.2 * std)
    assert bank_that_continues(halfway, as_sharp, FACTORS) is as_sharp
    at = halfway.bank.names.index("M_q")
    moved = mean.copy()
    moved[at] += 3.0 * 2.0 * std[at]
    kept = bank_that_continues(halfway, replace(halfway, mean=moved, std=2.0 * std), FACTORS)
    assert kept is not None and kept.state is halfway.state
    assert (
        kept.start_dependence[at] == pytest.approx(6.0 * std[at])
        and np.count_nonzero(kept.start_dependence) == 1
    )
    assert joint_estimate(kept).sigma("M_q") == pytest.approx(37.0**0.5 * std[at])
    agreed = bank_that_continues(halfway, replace(halfway, mean=mean + std, std=2.0 * std), FACTORS)
    assert agreed is not None and not agreed.start_dependence.any()


def test_another_grid_of_delays_holds_the_same_gaussian(halfway: Relinearised) -> None:
    mean, covariance = joint_moments(halfway.bank, halfway.state)
    coarse = replace(
        halfway,
        state=halfway.state._replace(
            log_likelihood=-0.5 * (np.arange(len(halfway.bank.delays)) - 3.2) ** 2 / 0.4**2
        ),
    )
    before_mean, before = joint_moments(coarse.bank, coarse.state)
    anew = with_fitting_grid(coarse)
    assert np.diff(anew.bank.delays)[0] < np.diff(coarse.bank.delays)[0]
    after_mean, after = joint_moments(anew.bank, anew.state)
    std = np.sqrt(np.diagonal(before))
    np.testing.assert_allclose((after_mean - before_mean) / std, 0.0, atol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diagonal(after)) / std, 1.0, atol=2e-3)
    assert with_fitting_grid(halfway) is halfway
    assert np.isfinite(mean).all() and np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize(
    ("centre", "width"), [(0.012, 0.01), (0.195, 0.01), (0.1, 0.07), (0.1, 0.3)]
)
def test_a_delay_near_the_ends_becomes_no_narrower_by_a_grid_laid_anew(
    halfway: Relinearised, centre: float, width: float
) -> None:
    # Two delays a sigma of it to either side have these moments; they are no grid, so that one is
    # laid, again and again if it had to be.
    pair = with_delays(halfway.bank, np.array([centre - width, centre + width]))
    alike = halfway.state._replace(
        mean=np.repeat(halfway.state.mean[:, :1], 2, axis=1),
        covariance=np.repeat(halfway.state.covariance[:1], 2, axis=0),
        log_likelihood=np.zeros(2),
        sound=np.ones(2, dtype=bool),
    )
    current = replace(halfway, bank=replace(pair, memory=halfway.bank.memory), state=alike)
    for _ in range(20):
        current = with_fitting_grid(current)
    mean, covariance = joint_moments(current.bank, current.state)
    # The Gaussian cut off where no delay can be, by quadrature.
    fine = np.linspace(0.0, halfway.bank.memory, 20001)
    density = np.exp(-0.5 * ((fine - centre) / width) ** 2)
    expected = float(density @ fine / density.sum())
    std = float(np.sqrt(density @ (fine - expected) ** 2 / density.sum()))
    assert mean[-1] == pytest.approx(expected, abs=0.1 * std)
    assert np.sqrt(covariance[-1, -1]) == pytest.approx(std, rel=0.06)


def test_moments_over_filters_are_those_of_the_mixture(halfway: Relinearised) -> None:
    state, bank = halfway.state, halfway.bank
    mean, covariance = joint_moments(bank, state)
    rng = np.random.default_rng(1)
    weights = np.exp(state.log_likelihood - state.log_likelihood.max())
    chosen = rng.choice(len(bank.delays), 40000, p=weights / weights.sum())
    squares, axes = np.linalg.eigh(0.5 * (state.covariance + state.covariance.transpose(0, 2, 1)))
    roots = axes * np.sqrt(np.maximum(squares, 0.0))[:, None, :]
    drawn = state.mean[:, chosen].T + np.einsum(
        "kij,kj->ki", roots[chosen], rng.standard_normal((len(chosen), len(mean) - 1))
    )
    drawn = np.column_stack([drawn, bank.delays[chosen]])
    std = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose((drawn.mean(axis=0) - mean) / std, 0.0, atol=4.0 / 200.0)
    np.testing.assert_allclose(np.corrcoef(drawn.T), covariance / np.outer(std, std), atol=0.025)
    np.testing.assert_allclose(drawn.std(axis=0) / std, 1.0, atol=4.0 / 200.0 / 2**0.5)


def test_before_the_maneuver_nothing_is_told(
    flown: tuple[Record, System, OnlineBank, Rows], states: list[BankState]
) -> None:
    record, system, bank, _ = flown
    assert not informative_enough(bank, states[12], FACTORS) and informative_enough(
        bank, states[HALF], FACTORS
    )
    quiet = record.window(0.0, float(record.time[12]))
    assert linearise(quiet, system, bank, states[12], bank.start[:, None]) is None
