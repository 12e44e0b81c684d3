"""A record with gaps in its time becomes several; each sample is in one of them, and none lies in a
gap.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.preparation.filtering import (
    FEWEST_PART_SAMPLES,
    PartedRecord,
    parts_of,
    put_together,
    split_at_gaps,
)
from sim.record import Channel, Record


def record(time: np.ndarray) -> Record:
    return Record(
        time,
        (Channel.of("elevator", "rad", 0 * time),),
        (Channel.of("q", "rad/s", np.sin(time)),),
        name="flight.csv",
    )


@given(
    st.lists(st.integers(40, 90), min_size=1, max_size=4),
    st.floats(0.3, 60.0),
    st.floats(0.005, 0.05),
)
def test_every_sample_is_kept_and_none_is_simulated_through(
    sizes: list[int], gap: float, step: float
) -> None:
    steps = np.full(sum(sizes), step)
    steps[np.cumsum(sizes)[:-1]] = gap
    time = np.cumsum(steps)
    parts, note = split_at_gaps(record(time))
    assert [len(part) for part in parts] == sizes and bool(note) == (len(sizes) > 1)
    assert np.concatenate([part.time for part in parts]).tolist() == time.tolist()
    assert len({part.name for part in parts}) == len(parts)


def test_short_losses_are_bridged() -> None:
    time = 0.012 * np.arange(600)
    (whole,), note = split_at_gaps(record(np.delete(time, slice(200, 208))))
    assert len(whole) == 592 and not note


def test_a_scrap_is_left_out() -> None:
    time = np.concatenate(
        [
            0.02 * np.arange(200),
            50.0 + 0.02 * np.arange(FEWEST_PART_SAMPLES - 1),
            90.0 + 0.02 * np.arange(200),
        ]
    )
    parts, note = split_at_gaps(record(time))
    assert [len(part) for part in parts] == [200, 200]
    assert "2 gaps" in note and "1 part of fewer than 30 samples left out" in note


def test_slow_uneven_records_have_no_gaps() -> None:
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.05, 0.2, 300))
    assert split_at_gaps(record(time))[1] == ""
    slow = np.cumsum(rng.uniform(0.8, 1.3, 50))
    assert split_at_gaps(record(slow))[1] == ""


@pytest.mark.parametrize("count", [3, 12])
def test_a_record_of_scraps_alone_keeps_them(count: int) -> None:
    time = np.concatenate([10.0 * part + 0.02 * np.arange(count) for part in range(4)])
    assert [len(part) for part in split_at_gaps(record(time))[0]] == [count] * 4


@given(st.lists(st.sampled_from([5, 12, 40, 60]), min_size=1, max_size=5), st.booleans())
def test_parts_put_together_have_every_row(sizes: list[int], resampled: bool) -> None:
    steps = np.full(sum(sizes), 0.02)
    steps[np.cumsum(sizes)[:-1]] = 3.0
    whole = record(np.cumsum(steps))
    parts, _ = split_at_gaps(whole)
    parted = PartedRecord("flight.csv", None if resampled else whole.time, len(parts))
    ((same, span),) = parts_of([parted], parts)
    assert same is parted and parts[span] == parts
    rows = [np.array([2.0 * part.time]) for part in parts]
    joined, (predicted,) = put_together(parted, parts, [rows])
    times = np.concatenate([part.time for part in parts])
    assert (
        joined.name == "flight.csv"
        and joined.time.tolist() == (times if resampled else whole.time).tolist()
    )
    inside = np.isin(joined.time, times)
    assert joined["q"].valid.tolist() == inside.tolist()
    np.testing.assert_array_equal(joined["q"].values[inside], np.sin(times))
    np.testing.assert_array_equal(predicted[0][inside], 2.0 * times)
    assert np.all(np.isfinite(predicted)) and np.allclose(predicted[0][~inside], 2.0 * times.mean())


def test_a_part_lacks_the_outputs_that_it_has_no_sample_of() -> None:
    time = np.concatenate(
        [0.02 * np.arange(50), 5.0 + 0.02 * np.arange(50), 9.0 + 0.02 * np.arange(50)]
    )
    q = np.where(time > 4.0, np.nan, np.sin(time))
    alpha = np.where(time > 8.0, np.nan, np.cos(time))
    whole = Record(
        time,
        (),
        (Channel.of("q", "rad/s", q), Channel.of("alpha", "rad", alpha)),
        name="flight.csv",
    )
    parts, note = split_at_gaps(whole)
    assert [part.output_names for part in parts] == [("q", "alpha"), ("alpha",)]
    assert "1 part of fewer than 30 samples" in note
    joined, _ = put_together(PartedRecord("flight.csv", time, 2), parts, ())
    assert (
        joined["q"].valid.tolist() == np.isfinite(q).tolist()
        and joined["alpha"].valid.tolist() == np.isfinite(alpha).tolist()
    )
