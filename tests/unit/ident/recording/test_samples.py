"""Samples that carry nothing: held, stuck, clipped, dropped out; and records in which the same
looks are no fault.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.recording.inspection import inspect
from ident.recording.series import (
    Certainty,
    Kind,
    RecordFinding,
    least_bit,
    quantity_text,
    series_of,
)
from sim.record import Channel, Record
from tests.recorded_flight import SIGMAS, altered, fall, flight, rounded

RNG = 7
TWELVE_BITS = {"alpha": np.radians(60.0) / 4096, "q": np.radians(120.0) / 4096, "nz": 12.0 / 4096}


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(RNG), offsets={"alpha": 0.08})


def found(record: Record, kind: Kind) -> RecordFinding:
    """The one finding; nothing else is a warning or masks."""
    told = [one for one in inspect(record) if one.certainty is not Certainty.NOTED]
    assert [one.kind for one in told] == [kind], [one.sentence for one in told]
    return told[0]


def held(period: float, phase: int = 0) -> Callable[[np.ndarray], np.ndarray]:
    """Sample and hold: a sample is taken whenever an even clock has passed."""

    def of(values: np.ndarray) -> np.ndarray:
        rows = np.arange(len(values))
        fresh = np.ceil(np.floor((rows - phase) / period) * period).astype(int) + phase
        return np.asarray(values[np.where(rows < phase, 0, np.minimum(fresh, rows))])

    return of


def stuck(first: int, count: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda v: np.where(
        (np.arange(len(v)) >= first) & (np.arange(len(v)) < first + count), v[first], v
    )


def test_a_sound_record_has_nothing_to_tell(sound: Record) -> None:
    assert inspect(sound) == ()
    assert inspect(fall(np.random.default_rng(1))) == ()


@pytest.mark.parametrize("channel", ["alpha", "q", "nz"])
@pytest.mark.parametrize(("period", "phase"), [(2, 0), (2, 1), (5, 3), (20, 7)])
def test_a_hold_is_found_with_period_and_phase_and_the_fresh_samples_are_kept(
    sound: Record, channel: str, period: int, phase: int
) -> None:
    one = found(altered(sound, **{channel: held(period, phase)}), Kind.HELD)
    assert one.channel == channel
    assert one.numbers["period"].value == pytest.approx(0.02 * period)
    assert not np.any(one.mask[phase::period]), "a fresh sample is masked"
    assert np.count_nonzero(~one.mask) <= len(sound) // period + 2


def test_a_hold_that_is_no_whole_number_of_rows_is_found(sound: Record) -> None:
    one = found(altered(sound, q=held(1.6)), Kind.HELD)
    assert one.numbers["samples"].value == pytest.approx(1.6, rel=0.02)
    values = held(1.6)(sound["q"].values)
    assert np.array_equal(one.mask, np.concatenate([[False], np.diff(values) == 0.0]))


def test_a_hold_is_found_below_a_coarse_converter(sound: Record) -> None:
    one = found(rounded(altered(sound, alpha=held(4, 1)), **TWELVE_BITS), Kind.HELD)
    assert one.numbers["samples"].value == 4.0 and not np.any(one.mask[1::4])


def test_a_channel_that_stands_for_a_while_is_masked_but_for_its_first_sample(
    sound: Record,
) -> None:
    one = found(altered(sound, q=stuck(300, 30)), Kind.STUCK)
    assert one.times == ((sound.time[300], sound.time[329]),)
    assert np.array_equal(np.flatnonzero(one.mask), np.arange(301, 330))


def test_a_run_of_zeros_leaves_no_first_sample(sound: Record) -> None:
    """Zeros among motion about zero are told as stuck; their first is no fresh measurement, and
    would stand as a spike.
    """
    rows = np.arange(len(sound))
    away = (rows >= 300) & (rows < 375)
    told = [
        one
        for one in inspect(altered(sound, q=lambda v: np.where(away, 0.0, v)))
        if one.certainty is Certainty.COSTS_INFORMATION
    ]
    masked = np.zeros(len(sound), dtype=bool)
    for one in told:
        masked |= one.mask
    assert {one.channel for one in told} == {"q"} and np.array_equal(masked, away)
    assert "are exact zeros" in told[0].sentence


def test_a_channel_that_dies_is_masked_to_the_end(sound: Record) -> None:
    one = found(altered(sound, alpha=stuck(500, 10_000)), Kind.STUCK)
    assert np.array_equal(np.flatnonzero(one.mask), np.arange(501, len(sound)))


def test_a_smooth_channel_that_stands_is_known_by_its_catching_up() -> None:
    smooth = flight(None, kind="sweep")
    first = 300 + int(np.argmax(np.abs(smooth["q"].values[300:500])))
    one = found(altered(smooth, alpha=stuck(first, 12)), Kind.STUCK)
    assert np.array_equal(np.flatnonzero(one.mask), np.arange(first + 1, first + 12))


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["doublets", "sweep"])
def test_rest_and_coarse_converters_are_no_faults(noise: float, kind: str) -> None:
    """Rests between doublets, slow turning points, and rounding from far below to far above the
    noise; without any noise, too.
    """
    flown = flight(np.random.default_rng(3) if noise else None, kind=kind, noise=noise)
    for bits in (
        {},
        TWELVE_BITS,
        {"alpha": 0.005, "q": 0.01, "nz": 0.05},
        {"alpha": 1e-5, "q": 1e-5, "nz": 1e-4},
    ):
        assert [
            one.sentence
            for one in inspect(rounded(flown, **bits))
            if one.certainty is not Certainty.NOTED
        ] == []


def test_rounding_of_a_fall_is_no_hold() -> None:
    for bit in (0.1, 1.0, 10.0):
        for rng in (None, np.random.default_rng(2)):
            told = inspect(rounded(fall(rng, rate=50.0, sigma=0.5), altitude=bit))
            assert {one.kind for one in told} <= {Kind.RESOLUTION}


def test_a_clipped_channel_is_masked_at_its_level(sound: Record) -> None:
    level = 1.0 + 0.6 * float(np.max(sound["nz"].values) - 1.0)
    one = found(altered(sound, nz=lambda v: np.minimum(v, level)), Kind.CLIPPED)
    assert one.numbers["level"].value == pytest.approx(level)
    assert np.array_equal(one.mask, sound["nz"].values >= level)


def test_a_smooth_clipped_channel_is_known_by_its_corners() -> None:
    smooth = flight(None, kind="sweep")
    level = 1.0 - 0.6 * float(1.0 - np.min(smooth["nz"].values))
    one = found(altered(smooth, nz=lambda v: np.maximum(v, level)), Kind.CLIPPED)
    assert one.numbers["level"].value == pytest.approx(level) and one.count > 20


def test_an_input_at_its_stop_is_noted_and_a_square_one_is_not() -> None:
    swept = flight(np.random.default_rng(4), kind="sweep")
    (note, *_) = told = inspect(altered(swept, elevator=lambda v: np.clip(v, -0.02, 0.02)))
    assert [one.certainty for one in told] == [Certainty.NOTED] * len(told)
    assert note.channel == "elevator" and "at its stop" in note.sentence
    assert inspect(flight(np.random.default_rng(4), kind="steps")) == ()


def test_dropouts_to_zero_are_masked(sound: Record) -> None:
    def dropped(values: np.ndarray) -> np.ndarray:
        return np.where(np.isin(np.arange(len(values)), (200, 350, 351, 352, 600)), 0.0, values)

    one = found(altered(sound, nz=dropped), Kind.DROPOUT)
    assert np.array_equal(np.flatnonzero(one.mask), (200, 350, 351, 352, 600))


def test_a_fill_value_is_masked(sound: Record) -> None:
    one = found(
        altered(sound, q=lambda v: np.where(np.arange(len(v)) % 97 == 5, -999.0, v)), Kind.DROPOUT
    )
    assert (
        np.array_equal(np.flatnonzero(one.mask), np.arange(5, len(sound), 97))
        and "-999" in one.sentence
    )


def test_a_dropout_of_an_input_is_told_and_not_masked() -> None:
    trimmed = altered(flight(np.random.default_rng(5), kind="sweep"), elevator=lambda v: v + 0.2)
    one = found(
        altered(
            trimmed, elevator=lambda v: np.where(np.isin(np.arange(len(v)), (400, 401)), 0.0, v)
        ),
        Kind.DROPOUT,
    )
    assert one.certainty is Certainty.LIKELY and not one.mask.size


def test_missing_rows_matter_where_an_input_moves(sound: Record) -> None:
    def without(first: int) -> Record:
        keep = ~np.isin(np.arange(len(sound)), np.arange(first, first + 4))
        cut = [
            tuple(Channel.of(c.name, c.unit, c.values[keep]) for c in group)
            for group in (sound.inputs, sound.outputs)
        ]
        return replace(sound, time=sound.time[keep], inputs=cut[0], outputs=cut[1])

    moved = int(np.flatnonzero(np.diff(sound.inputs[0].values))[1])
    one = found(without(moved - 1), Kind.ROWS_MISSING)
    assert one.certainty is Certainty.LIKELY and one.numbers["rows"].value == 4.0
    (noted,) = inspect(without(600))
    assert (noted.kind, noted.certainty) == (Kind.ROWS_MISSING, Certainty.NOTED)


def test_uneven_sampling_and_columns_at_two_rates_are_no_faults(sound: Record) -> None:
    rng = np.random.default_rng(6)
    assert inspect(replace(sound, time=sound.time + rng.uniform(0.0, 0.008, len(sound)))) == ()
    assert (
        inspect(altered(sound, alpha=lambda v: np.where(np.arange(len(v)) % 4 == 1, v, np.nan)))
        == ()
    )


def test_a_coarse_least_bit_is_noted(sound: Record) -> None:
    told = [one for one in inspect(rounded(sound, alpha=0.006)) if one.kind is Kind.RESOLUTION]
    assert [(one.channel, one.certainty) for one in told] == [("alpha", Certainty.NOTED)]
    assert (
        told[0].numbers["least_bit"].value == pytest.approx(0.006)
        and quantity_text(0.006, "rad") in told[0].sentence
    )
    assert inspect(rounded(sound, alpha=0.0005)) == ()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-8, 1e8), st.floats(-1e3, 1e3), st.integers(100, 2000))
def test_the_least_bit_is_read_off_any_grid(
    seed: int, bit: float, offset: float, count: int
) -> None:
    numbers = np.unique(np.random.default_rng(seed).integers(0, 5_000, count))
    step = float(np.gcd.reduce(np.diff(numbers))) if len(numbers) > 1 else 0.0
    assert least_bit(bit * (numbers + round(offset))) == pytest.approx(step * bit, rel=1e-6)


def test_noise_is_read_below_the_motion(sound: Record) -> None:
    for name in ("alpha", "q", "nz"):
        series = series_of(sound, sound[name])
        assert series.white and series.noise == pytest.approx(SIGMAS[name], rel=0.15)


def test_a_sample_is_masked_once_by_whatever_comes_first(sound: Record) -> None:
    twice = altered(
        altered(sound, q=stuck(300, 30)),
        q=lambda v: np.where(np.arange(len(v)) % 97 == 5, -999.0, v),
    )
    told = [one for one in inspect(twice) if one.mask.size]
    assert {one.kind for one in told} == {Kind.DROPOUT, Kind.STUCK}
    assert np.count_nonzero(np.logical_or.reduce([one.mask for one in told])) == sum(
        one.count for one in told
    )


@pytest.mark.parametrize("lost", [0.0, 0.12])
def test_counts_of_a_converter_behind_a_slow_correction_repeat_by_chance(*, lost: float) -> None:
    """A coarse converter whose counts a slow, coarse correction shifts has no exact least bit; rows
    without an update repeat whatever they are.
    """
    rng, time = np.random.default_rng(4), np.arange(750) * 0.04
    angle = (
        2.2
        + 0.5 * np.sin(0.8 * time) * (time > 6.0) * (time < 14.0)
        + 0.005 * rng.standard_normal(time.size)
    )
    bit = 0.0083 if lost == 0.0 else 0.0001
    values = bit * np.round(angle / bit) + 0.0012 * np.round(
        np.sin(1.3 * time) + 0.3 * rng.standard_normal(time.size)
    )
    for k in np.flatnonzero(rng.random(time.size - 1) < lost) + 1:
        values[k] = values[k - 1]
    channel = Channel.of("alpha", "rad", np.radians(values))
    told = [
        one.kind
        for one in inspect(Record(time, (), (channel,)))
        if one.certainty is Certainty.COSTS_INFORMATION
    ]
    assert told == ([Kind.HELD] if lost else [])
