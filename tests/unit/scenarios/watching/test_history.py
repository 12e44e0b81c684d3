"""The rows of a watch's history against the states of its bank."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.banks.delays import DELAYS, likelihood_weights
from ident.banks.online import Rows, advance, begin, online_bank
from scenarios.watching.session import WatchStep
from scenarios.watching.study import columns, lines, nearest
from tests import loes_problem as problem


def test_a_row_has_means_sigmas_and_weights_of_the_state_after_it() -> None:
    flown = problem.record(1, duration=1.5)
    system = problem.system(flown)
    bank = online_bank(system, 0.02)
    z, valid = flown.output_array(system.output_names)
    rows = Rows(flown.time, flown.input_array(system.input_names), np.where(valid, z, np.nan))
    first = begin(bank, Rows(*(part[..., :1] for part in rows)))
    states = [first, *advance(bank, first, Rows(*(part[..., 1:] for part in rows)))]
    spread = 0.1 * np.arange(1.0, len(bank.names) + 1.0)
    steps = [
        WatchStep(
            np.array([state.time, 0.0, 0.0, 0.0, 0.0]),
            state,
            0,
            spread,
            0.0,
            np.zeros((1, len(bank.names))),
            None,
        )
        for state in states
    ]
    table = [
        dict(zip(columns(bank), row, strict=True))
        for row in csv.reader(lines(bank, steps).splitlines())
    ]
    assert len(table) == len(flown)
    for at in (0, 20, len(table) - 1):
        row, state = table[at], states[at]
        weights = likelihood_weights(state.log_likelihood)
        assert float(row["time"]) == pytest.approx(flown.time[at])
        assert float(row["most_likely_delay"]) == bank.delays[state.best]
        assert float(row["weighted_delay"]) == pytest.approx(weights @ bank.delays)
        assert float(row["weight_25ms"]) == pytest.approx(weights[1], abs=1e-9)
        for number, name in enumerate(bank.names):
            assert float(row[name]) == pytest.approx(
                state.mean[number, state.best], rel=1e-8, abs=1e-12
            )
            assert float(row[f"{name}_std"]) == pytest.approx(
                state.std(state.best)[number], rel=1e-8
            )
            assert float(row[f"{name}_spread"]) == pytest.approx(spread[number])
        shown = [row[f"innovation_{name}"] for name in ("alpha", "q", "nz")]
        assert [float(cell) for cell in shown] == pytest.approx(state.innovation, rel=1e-3)


GRID = np.array(DELAYS)


@given(st.floats(0.0, 0.2), st.floats(1e-4, 0.05))
def test_weights_are_the_probabilities_that_a_delay_is_the_nearest(
    value: float, std: float
) -> None:
    weights = nearest(GRID, value, std)
    assert weights.sum() == pytest.approx(1.0) and np.all(weights >= 0.0)
    # Seen in a mirror the weights are in the other order.
    np.testing.assert_allclose(
        nearest(0.2 - GRID[::-1], 0.2 - value, std)[::-1], weights, atol=1e-9
    )


def test_weights_are_those_that_are_counted() -> None:
    value, std, drawn = 0.107, 0.012, np.random.default_rng(1)
    at = np.argmin(np.abs(value + std * drawn.standard_normal(100_000)[:, None] - GRID), axis=1)
    np.testing.assert_allclose(
        nearest(GRID, value, std), np.bincount(at, minlength=len(GRID)) / 100_000, atol=0.006
    )
    assert nearest(GRID, 0.05, 0.0).tolist() == [0.0, 0.0, 1.0, *[0.0] * 6]
