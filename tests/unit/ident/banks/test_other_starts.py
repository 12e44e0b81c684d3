"""Other starts beside a bank: an orthogonal design, the same filters as alone, and a spread that
says how far they end apart.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ident.banks.online import (
    MEDIAN_SQUARE,
    BankState,
    OnlineBank,
    Rows,
    advance,
    bank_of_starts,
    begin,
    changed_starts,
    most_likely_by_start,
    online_bank,
    spread_covariance,
    start_spread,
)
from sim.errors import ModelError
from tests import loes_problem as problem

FACTORS = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau")


def run(bank: OnlineBank, rows: Rows) -> list[BankState]:
    first = begin(bank, Rows(*(part[..., :1] for part in rows)))
    return [first, *advance(bank, first, Rows(*(part[..., 1:] for part in rows)))]


@pytest.fixture(scope="module")
def flown() -> tuple[OnlineBank, Rows]:
    record = problem.record(3, duration=5.0)
    bank = online_bank(problem.system(record, share=1.3), 0.04)
    z, valid = record.output_array(bank.system.output_names)
    return bank, Rows(
        record.time, record.input_array(bank.system.input_names), np.where(valid, z, np.nan)
    )


def test_the_starts_are_an_orthogonal_design_of_one_sigma(flown: tuple[OnlineBank, Rows]) -> None:
    bank, _ = flown
    moved = changed_starts(bank, FACTORS) - bank.start[:, None]
    at = [bank.names.index(name) for name in FACTORS]
    std = np.sqrt(np.diagonal(bank.covariance))
    assert moved.shape[1] == 8
    np.testing.assert_allclose(moved[at] @ moved[at].T, 8 * np.diag(np.square(std[at])), atol=1e-9)
    np.testing.assert_allclose(moved.sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_array_equal(np.delete(moved, at, axis=0), 0.0)
    assert (
        changed_starts(bank, FACTORS[:4]).shape[1] == 8
        and changed_starts(bank, FACTORS[:3]).shape[1] == 4
    )
    with pytest.raises(ModelError, match="other starts, delay"):
        changed_starts(bank, ["delay"])
    assert pytest.approx(chi2.median(1), rel=1e-5) == MEDIAN_SQUARE


def test_they_are_the_filters_that_run_alone_and_their_spread_is_that_of_the_ends(
    flown: tuple[OnlineBank, Rows],
) -> None:
    bank, rows = flown
    starts = changed_starts(bank, FACTORS)
    others = bank_of_starts(bank, starts)
    beside, states = run(others, rows), run(bank, rows)
    ends = most_likely_by_start(others, beside, len(bank.delays))
    alone = [run(replace(bank, start=start), rows)[-1] for start in starts.T]
    own, best = states[-1].mean[:, states[-1].best], states[-1].best
    for k, state in enumerate(alone):
        np.testing.assert_allclose(
            ends.mean[-1, k], state.mean[:, state.best], rtol=1e-9, atol=1e-12
        )
        assert ends.delay[-1, k] == bank.delays[state.best]
    spread = start_spread(bank, states, ends)
    ended = np.array([state.mean[:, state.best] for state in alone]) - own
    slope = (states[-1].mean[:, best + 1] - states[-1].mean[:, best - 1]) / 0.05
    expected = np.sqrt(np.median(ended**2, axis=0) / MEDIAN_SQUARE + slope**2 * 0.025**2 / 12.0)
    np.testing.assert_allclose(spread.std[-1], expected, rtol=1e-7)
    # A start that is 30 % off leads the lag elsewhere by several of the sigmas that the filter
    # prints.
    lag = bank.names.index("inv_tau")
    assert spread.std[-1, lag] > 3.0 * states[-1].std(best)[lag]


def test_where_half_of_the_starts_broke_down_nothing_is_known(
    flown: tuple[OnlineBank, Rows],
) -> None:
    bank, rows = flown
    few = Rows(*(part[..., :40] for part in rows))
    states = run(bank, few)
    others = bank_of_starts(bank, changed_starts(bank, FACTORS))
    ends = most_likely_by_start(others, run(others, few), len(bank.delays))
    for broken, known in ((3, True), (4, False)):
        sound = ends.sound.copy()
        sound[:, :broken] = False
        assert (
            np.isfinite(start_spread(bank, states, ends._replace(sound=sound)).std).all() == known
        )


def test_covariance_of_a_spread_has_its_deviations_and_is_one() -> None:
    differences = np.random.default_rng(1).standard_normal((8, 5)) * [1.0, 2.0, 0.5, 3.0, 0.0]
    std = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    found = spread_covariance(std, differences)
    np.testing.assert_allclose(np.sqrt(np.diagonal(found)), std)
    assert np.linalg.eigvalsh(found).min() > -1e-9
    expected = differences[:, :4].T @ differences[:, :4]
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found[:4, :4] / np.outer(std[:4], std[:4]), expected / np.outer(scale, scale), atol=1e-12
    )
