"""Faults of a recorder against what they say of themselves, and what they leave alone."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from exam import recorder_faults as faults
from sim.record import Channel, Record

TIME = 0.02 * np.arange(1000)
RNG = np.random.default_rng(1)
RECORD = Record(
    TIME,
    (Channel.of("elevator", "rad", 0.05 * np.sign(np.sin(TIME))),),
    tuple(
        Channel.of(name, unit, RNG.standard_normal(1000))
        for name, unit in (("alpha", "rad"), ("q", "rad/s"))
    ),
)
SPELL = {"begin": 4.0, "length": 2.0}
INSIDE = (TIME >= 4.0) & (TIME < 6.0)


def others_alone(found: Record, *spoiled: str) -> bool:
    same = [
        name
        for name in ("elevator", "alpha", "q")
        if np.array_equal(found[name].values, RECORD[name].values)
    ]
    return np.array_equal(found.time, TIME) and set(same) == {"elevator", "alpha", "q"} - set(
        spoiled
    )


def test_a_fast_clock_stretches_time_alone() -> None:
    found = faults.fast_clock(RECORD, {"factor": 1.1}, RNG)
    assert np.allclose(found.time, 1.1 * TIME, rtol=1e-14) and np.array_equal(
        found["q"].values, RECORD["q"].values
    )


def test_missing_rows_leave_a_gap_and_lost_ones_none() -> None:
    missing, lost = faults.rows_missing(RECORD, SPELL, RNG), faults.rows_lost(RECORD, SPELL, RNG)
    assert len(missing) == len(lost) == 900 and np.diff(missing.time).max() == pytest.approx(2.02)
    assert np.diff(lost.time).max() == pytest.approx(0.02)
    for found in (missing, lost):
        assert np.array_equal(found["q"].values, RECORD["q"].values[~INSIDE])
        assert np.array_equal(found["elevator"].values, RECORD["elevator"].values[~INSIDE])


def test_a_held_column_is_new_every_so_many_rows() -> None:
    found = faults.held("q", RECORD, {"rows": 4.0}, RNG)
    assert others_alone(found, "q")
    assert np.array_equal(np.flatnonzero(np.diff(found["q"].values)) % 4, np.full(249, 3))
    assert np.array_equal(found["q"].values[::4], RECORD["q"].values[::4])


@pytest.mark.parametrize("zero", [0.0, 1.0])
def test_a_dead_stretch_repeats_the_last_value_or_is_zero(zero: float) -> None:
    found = faults.dead("alpha", RECORD, {**SPELL, "zero": zero}, RNG)
    assert others_alone(found, "alpha")
    assert np.all(found["alpha"].values[INSIDE] == (0.0 if zero else RECORD["alpha"].values[199]))
    assert np.array_equal(found["alpha"].values[~INSIDE], RECORD["alpha"].values[~INSIDE])


def test_a_skewed_column_comes_rows_late() -> None:
    found = faults.skewed("q", RECORD, {"rows": 2.0}, RNG)
    assert others_alone(found, "q") and np.array_equal(
        found["q"].values[2:], RECORD["q"].values[:-2]
    )


def test_exchanged_samples_flight_each_others_column() -> None:
    found = faults.exchanged("alpha", "q", RECORD, {"count": 6.0}, np.random.default_rng(3))
    rows = np.flatnonzero(found["alpha"].values != RECORD["alpha"].values)
    assert len(rows) == 6 and others_alone(found, "alpha", "q")
    assert np.array_equal(found["alpha"].values[rows], RECORD["q"].values[rows])
    assert np.array_equal(found["q"].values[rows], RECORD["alpha"].values[rows])


def test_a_burst_adds_noise_of_its_size_while_it_lasts() -> None:
    found = faults.burst(
        "q", RECORD, {"begin": 2.0, "length": 16.0, "sigma": 3.0}, np.random.default_rng(2)
    )
    more = (found["q"].values - RECORD["q"].values)[(TIME >= 2.0) & (TIME < 18.0)]
    assert others_alone(found, "q") and np.count_nonzero(
        found["q"].values - RECORD["q"].values
    ) == len(more)
    # A standard deviation of 800 normal numbers is known to 2.5 per cent: four of those.
    assert np.std(more) == pytest.approx(3.0, rel=0.1)


def test_a_coarse_column_has_values_on_a_grid_only() -> None:
    found = faults.coarse("q", RECORD, {"bit": 0.25}, RNG)
    off = found["q"].values - RECORD["q"].values
    assert (
        others_alone(found, "q")
        and np.max(np.abs(off)) <= 0.125
        and np.all(found["q"].values % 0.25 == 0.0)
    )


def test_a_clipped_column_ends_short_of_its_range_on_both_sides() -> None:
    found = faults.clipped("alpha", RECORD, {"share": 0.2}, RNG)
    column = RECORD["alpha"].values
    assert others_alone(found, "alpha")
    assert np.ptp(found["alpha"].values) == pytest.approx(0.6 * np.ptp(column))
    inside = np.abs(column - 0.5 * (column.max() + column.min())) < 0.29 * np.ptp(column)
    assert np.array_equal(found["alpha"].values[inside], column[inside])


@pytest.mark.parametrize(("name", "factor"), [("elevator", -1.0), ("q", 57.3)])
def test_a_sign_and_a_unit_are_factors_on_one_column(name: str, factor: float) -> None:
    found = faults.scaled(name, RECORD, {"factor": factor}, RNG)
    assert others_alone(found, name) and np.array_equal(
        found[name].values, factor * RECORD[name].values
    )


@pytest.mark.parametrize(
    "act",
    [
        faults.rows_missing,
        faults.rows_lost,
        partial(faults.held, "q"),
        partial(faults.burst, "q"),
        partial(faults.exchanged, "alpha", "q"),
    ],
)
def test_a_fault_leaves_the_record_that_it_was_given(act) -> None:
    before = [channel.values.copy() for channel in RECORD.channels]
    act(RECORD, {**SPELL, "rows": 3.0, "sigma": 1.0, "count": 5.0}, np.random.default_rng(1))
    assert all(
        np.array_equal(a, channel.values)
        for a, channel in zip(before, RECORD.channels, strict=True)
    )
