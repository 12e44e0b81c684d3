"""The bank one row at a time: equal to the batch however rows come, with gaps, uneven times, spikes
and breakdowns; what it refuses.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.banks.bank import BankEstimate, run_bank
from ident.banks.delays import DELAYS
from ident.banks.online import (
    LONGEST_SPIKE,
    BankState,
    OnlineBank,
    Rows,
    advance,
    bank_estimate,
    begin,
    online_bank,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Channel, Record
from tests import loes_problem as problem
from tests.bases import rigid_model


def rows_of(record: Record, system: System) -> Rows:
    z, valid = record.output_array(system.output_names)
    return Rows(record.time, record.input_array(system.input_names), np.where(valid, z, np.nan))


def states_of(bank: OnlineBank, rows: Rows, cuts: list[int] | None = None) -> list[BankState]:
    """The states after all rows, which come in groups that begin at the cuts."""
    states = [begin(bank, Rows(*(part[..., :1] for part in rows)))]
    edges = [1, *(cuts or []), len(rows.time)]
    for first, last in pairwise(edges):
        states += advance(bank, states[-1], Rows(*(part[..., first:last] for part in rows)))
    return states


def batch(record: Record, system: System) -> BankEstimate:
    return run_bank(record, system, fixed_values={"delay": np.array(DELAYS)})


def assert_equal(found: BankEstimate, expected: BankEstimate) -> None:
    np.testing.assert_allclose((found.mean - expected.mean) / expected.std, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.std, expected.std, rtol=1e-9)
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, rtol=1e-9)
    np.testing.assert_array_equal(found.sound, expected.sound)


def thinned(record: Record, seed: int) -> Record:
    """The record with a third of its rows lost, so that the times are uneven."""
    keep = np.random.default_rng(seed).random(len(record)) > 0.33
    keep[0] = True

    def cut(channel: Channel) -> Channel:
        return replace(channel, values=channel.values[keep], valid=channel.valid[keep])

    return replace(
        record,
        time=record.time[keep],
        inputs=tuple(map(cut, record.inputs)),
        outputs=tuple(map(cut, record.outputs)),
    )


@pytest.mark.parametrize("gaps", [False, True], ids=["whole", "gaps"])
@pytest.mark.parametrize("uneven", [False, True], ids=["even", "uneven"])
def test_final_estimate_is_that_of_the_batch(gaps: bool, uneven: bool) -> None:
    flown = problem.record(1, duration=4.0, gaps=gaps)
    flown = thinned(flown, 3) if uneven else flown
    system = problem.system(flown)
    bank = online_bank(system, 0.04)
    states = states_of(bank, rows_of(flown, system))
    assert [state.rows_seen for state in states] == list(range(1, len(flown) + 1))
    assert_equal(bank_estimate(bank, states[-1]), batch(flown, system))
    for k in (11, 37):
        assert_equal(
            bank_estimate(bank, states[k]),
            batch(flown.window(flown.time[0], flown.time[k]), system),
        )


def test_without_process_noise_and_without_a_channel() -> None:
    flown = problem.record(2, duration=2.4).only(["alpha", "q"])
    system = problem.system(flown, density={"alpha": 0.0})
    bank = online_bank(system, 0.04)
    assert_equal(
        bank_estimate(bank, states_of(bank, rows_of(flown, system))[-1]), batch(flown, system)
    )


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(2, 59), max_size=12, unique=True).map(sorted))
def test_grouping_of_rows_changes_nothing_but_rounding(cuts: list[int]) -> None:
    flown = problem.record(1, duration=2.4, gaps=True)
    system = problem.system(flown)
    bank, rows = online_bank(system, 0.04), rows_of(flown, system)
    grouped, alone = (
        states_of(bank, rows, cuts)[-1],
        states_of(bank, rows, list(range(2, len(flown))))[-1],
    )
    assert_equal(bank_estimate(bank, grouped), bank_estimate(bank, alone))


def test_states_are_left_as_they_were() -> None:
    flown = problem.record(1, duration=1.6)
    system = problem.system(flown)
    bank, rows = online_bank(system, 0.04), rows_of(flown, system)
    first = begin(bank, Rows(*(part[..., :1] for part in rows)))
    kept = [np.copy(part) for part in first]
    later = Rows(*(part[..., 1:] for part in rows))
    once, again = advance(bank, first, later)[-1], advance(bank, first, later)[-1]
    for part, before in zip(first, kept, strict=True):
        np.testing.assert_array_equal(part, before)
    np.testing.assert_array_equal(once.mean, again.mean)
    assert advance(bank, first, Rows(*(part[..., :0] for part in rows))) == []


def test_only_as_much_of_the_past_is_kept_as_the_longest_delay_needs() -> None:
    flown = problem.record(1, duration=4.0)
    system = problem.system(flown)
    last = states_of(online_bank(system, 0.04), rows_of(flown, system))[-1]
    assert last.past_time[0] <= last.time - DELAYS[-1] < last.past_time[1]


def test_a_spike_counts_as_missing() -> None:
    flown = problem.record(4, duration=3.0)
    system = problem.system(flown)
    bank, rows = online_bank(system, 0.04, gate=30.0), rows_of(flown, system)
    spoiled = rows.outputs.copy()
    spoiled[0, 20], spoiled[1, 33] = 1e6, -4.0
    states = states_of(bank, rows._replace(outputs=spoiled))
    assert {
        (k, int(i)) for k, state in enumerate(states) for i in np.flatnonzero(state.skipped)
    } == {(20, 0), (33, 1)}
    assert abs(states[20].innovation[0]) > 1e6 and states[33].innovation[1] < -30.0
    missing = rows.outputs.copy()
    missing[0, 20] = missing[1, 33] = np.nan
    masked = replace(
        flown,
        outputs=tuple(
            Channel.of(c.name, c.unit, row) for c, row in zip(flown.outputs, missing, strict=True)
        ),
    )
    assert_equal(bank_estimate(bank, states[-1]), batch(masked, system))


def test_what_lasts_is_believed() -> None:
    flown = problem.record(4, duration=3.0)
    system = problem.system(flown)
    bank, rows = online_bank(system, 0.04, gate=30.0), rows_of(flown, system)
    moved = rows.outputs.copy()
    moved[0, 40:] += 0.5
    skipped = [
        k
        for k, state in enumerate(states_of(bank, rows._replace(outputs=moved)))
        if state.skipped[0]
    ]
    assert skipped[:LONGEST_SPIKE] == [40, 41, 42] and 43 not in skipped


def test_runs_that_break_down_keep_their_last_sound_values() -> None:
    flown = problem.record(5, duration=2.0)
    alpha = flown["alpha"].values.copy()
    alpha[30] = 1e60
    broken = replace(flown, outputs=(replace(flown["alpha"], values=alpha), *flown.outputs[1:]))
    system = problem.system(broken)
    bank = online_bank(system, 0.04)
    states = states_of(bank, rows_of(broken, system))
    found, expected = bank_estimate(bank, states[-1]), batch(broken, system)
    assert not found.sound.any() and np.isneginf(found.log_likelihood).all()
    np.testing.assert_array_equal(found.sound, expected.sound)
    np.testing.assert_allclose((found.mean - expected.mean) / expected.std, 0.0, atol=1e-9)
    np.testing.assert_array_equal(found.mean, states[29].mean)


def test_what_cannot_run_row_by_row_is_refused() -> None:
    flown = problem.record(4, duration=2.0)
    system = problem.system(flown)
    with pytest.raises(ModelError, match="M_q: the parameter is free"):
        online_bank(system, 0.04, name="M_q")
    unknown = replace(system, noise=lambda p: ([0.0] * 3, [1e-6, np.nan, 1e-4]))
    with pytest.raises(ModelError, match="output q: its measurement noise"):
        online_bank(unknown, 0.04)
    walking = replace(
        system, declared_noise=replace(system.declared_noise, process_density={"M_q": 1e-3})
    )
    with pytest.raises(ModelError, match="M_q: the parameter is a random walk"):
        online_bank(walking, 0.04)
    curved = replace(system, f=lambda t, x, u, p: [x[0] * x[0], x[1], x[2]])
    with pytest.raises(ModelError, match="not sums of a parameter times a state"):
        online_bank(curved, 0.04)
    with pytest.raises(ModelError, match="acts on an output directly"):
        online_bank(compile_model(rigid_model(), ["nz"], online=True), 0.04, name="mass")
