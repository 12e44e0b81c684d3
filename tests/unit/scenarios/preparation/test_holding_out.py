"""The part of a record that is held out: the rest of it, excited, and never too short."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.preparation.plausibility import (
    EARLIEST_CUT_SHARE,
    FEWEST_PART_SAMPLES,
    LATEST_CUT_SHARE,
    hold_out,
)
from sim.errors import RecordError
from sim.record import Channel, Record
from tests.diagnoses import measured_record


def record_of(time: np.ndarray, control: np.ndarray | None) -> Record:
    inputs = () if control is None else (Channel.of("elevator", "rad", control),)
    return Record(time, inputs, (Channel.of("q", "rad/s", np.sin(time)),))


def excitation(record: Record, trim: float = 0.0) -> float:
    return float(np.sum((record["elevator"].values - trim) ** 2))


@given(st.integers(0, 10_000), st.integers(40, 400), st.floats(0.0, 0.9), st.booleans())
def test_parts_join_to_the_record_and_cut_in_the_allowed_stretch(
    seed: int, count: int, unevenness: float, moved: bool
) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(0.02 * (1.0 + unevenness * (rng.random(count) - 0.5)))
    control = (
        np.repeat(rng.standard_normal(count // 8 + 1), 8)[:count]
        * (rng.random(count // 8 + 1) > 0.5).repeat(8)[:count]
        if moved
        else None
    )
    record = record_of(time, control)
    try:
        first, last = hold_out(record)
    except RecordError as error:
        # A single deflection at the end: nothing before it could be fitted.
        assert (
            control is not None
            and "no control moves" in str(error)
            and not np.any(control[: FEWEST_PART_SAMPLES // 2])
        )
        return
    assert np.array_equal(np.concatenate([first.time, last.time]), record.time)
    assert np.array_equal(
        np.concatenate([first.output_array()[0], last.output_array()[0]], axis=1),
        record.output_array()[0],
    )
    assert first.hold is record.hold and first.name == last.name == record.name
    span = time[-1] - time[0]
    assert min(len(first), len(last)) >= FEWEST_PART_SAMPLES
    assert EARLIEST_CUT_SHARE * span <= last.time[0] - time[0] or len(first) == FEWEST_PART_SAMPLES
    assert (
        last.time[0] - time[0] <= LATEST_CUT_SHARE * span + 1e-9 or len(last) == FEWEST_PART_SAMPLES
    )


# the maneuver is over after 4.5 s of 20, 8 or 6
@pytest.mark.parametrize("count", [1001, 400, 300])
def test_both_parts_are_excited_wherever_the_maneuver_lies(count: int) -> None:
    record = measured_record(count=count)
    first, last = hold_out(record)
    assert 0.1 <= excitation(last) / excitation(record) <= 0.5
    assert excitation(first) >= 0.5 * excitation(record)


def test_cut_falls_into_a_rest_between_two_maneuvers() -> None:
    time = 0.02 * np.arange(1000)
    control = np.where((time > 1) & (time < 9), 0.05 * np.sign(np.sin(3.0 * time)), 0.0) + np.where(
        (time > 13) & (time < 16), 0.05, 0.0
    )
    first, last = hold_out(record_of(time, control))
    assert 9.4 <= last.time[0] <= 13.1
    assert first["elevator"].values[-20:].any() == False  # noqa: E712


def test_a_measured_attitude_is_no_control_that_excites() -> None:
    time = 0.02 * np.arange(1000)
    record = record_of(
        time, np.where((time > 1) & (time < 9), 0.05 * np.sign(np.sin(3.0 * time)), 0.0)
    )
    with_attitude = replace(
        record, inputs=(*record.inputs, Channel.of("theta", "rad", 0.01 * time))
    )
    assert hold_out(with_attitude)[1].time[0] == hold_out(record)[1].time[0]


def test_without_inputs_the_last_three_tenths_are_held_out() -> None:
    first, last = hold_out(record_of(np.linspace(5.0, 15.0, 101), None))
    assert last.time[0] == pytest.approx(12.0, abs=0.05) and len(first) + len(last) == 101


def test_a_trim_deflection_is_no_excitation() -> None:
    time = 0.02 * np.arange(1000)
    control = (
        0.3
        + np.where((time > 8) & (time < 9), 0.01, 0.0)
        + np.where((time > 14) & (time < 15), -0.01, 0.0)
    )
    _, last = hold_out(record_of(time, control))
    assert 9.0 < last.time[0] <= 14.02


def test_a_step_that_is_held_for_long_is_fitted_and_not_the_rest_before_it() -> None:
    """With the median as trim the rest before the step would be the excitation: 31 samples of it
    were fitted.
    """
    time = 0.02 * np.arange(1000)
    first, _ = hold_out(record_of(time, np.where(time > 1.0, 0.05, 0.0)))
    assert first.time[-1] > 10.0 and np.mean(first["elevator"].values > 0.0) > 0.8


def test_a_part_in_which_no_control_moves_is_not_fitted() -> None:
    time = 0.02 * np.arange(1000)
    record = record_of(time, np.where(time > 19.0, 0.05, 0.0))
    with pytest.raises(RecordError, match="no control moves before"):
        hold_out(record)


@pytest.mark.parametrize("count", [2, 10, 39])
def test_too_short_a_record_is_refused(count: int) -> None:
    with pytest.raises(
        RecordError, match=r"too few to hold a part out; give another record with --validate"
    ):
        hold_out(record_of(0.02 * np.arange(count), None))


def test_a_channel_that_ends_early_is_refused_by_name() -> None:
    time = 0.02 * np.arange(200)
    alpha = np.where(time < 1.0, 0.1, np.nan)
    record = Record(time, (), (Channel.of("q", "rad/s", time), Channel.of("alpha", "rad", alpha)))
    with pytest.raises(RecordError, match="not a single sample of alpha in the held-out part"):
        hold_out(record)
