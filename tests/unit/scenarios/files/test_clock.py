"""Clocks: whatever counts, rolls over, is rounded or printed as a date, the seconds come out."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.files.declarations import is_clock
from scenarios.files.measured.clock import (
    ROUNDED_STEP_SHARE,
    grid_of_coarse_stamps,
    seconds_of_counter,
    sorted_rows,
    times_of_dates,
    times_of_texts,
)
from sim.errors import RecordError


@given(
    st.floats(5.0, 900.0),
    st.sampled_from([("ms", 1e3), ("us", 1e6), ("ns", 1e9)]),
    st.integers(0, 10**9),
)
def test_an_unlabelled_counter_of_a_recorder_is_read_in_its_unit(
    rate: float, unit: tuple[str, float], start: int
) -> None:
    time = np.arange(60) / rate
    stamps = np.round(time * unit[1]) + start
    clock = seconds_of_counter(stamps, None)
    if unit[0] == "ms" and np.median(np.diff(stamps)) < 11:
        return  # steps of a few units may be seconds as well
    found = np.median(np.diff(clock.time))
    nearest = min(
        abs(np.log(np.median(np.diff(stamps)) * size * 50.0)) for size in (1.0, 1e-3, 1e-6, 1e-9)
    )
    assert abs(np.log(found * 50.0)) == pytest.approx(nearest, abs=1e-9)
    if 2.0 < rate < 1000.0:
        rounding = 2.0 * float(np.spacing(np.abs(clock.time).max()))  # of the two times of a step
        np.testing.assert_allclose(
            np.diff(clock.time), np.diff(stamps) / unit[1], rtol=1e-9, atol=rounding
        )


@pytest.mark.parametrize("bits", [16, 32])
def test_a_counter_that_begins_anew_goes_on(bits: int) -> None:
    count = (
        np.arange(300) * 2000 + 2**bits - 200 * 2000 if bits == 32 else np.arange(300) * 400 + 1000
    )
    clock = seconds_of_counter(np.mod(count, 2**bits).astype(float), "us")
    np.testing.assert_allclose(np.diff(clock.time), np.diff(count) * 1e-6, rtol=1e-9)
    assert "begins anew" in " ".join(clock.notes)


@pytest.mark.parametrize("step", [1.0, 2.0, 5.0, 10.0, 20.0])
def test_milliseconds_since_1970_are_milliseconds_at_any_rate(step: float) -> None:
    clock = seconds_of_counter(1.74e12 + step * np.arange(60), None)
    np.testing.assert_allclose(np.diff(clock.time), 1e-3 * step, rtol=1e-6)
    assert any("read in ms" in note for note in clock.notes)


def test_ten_milliseconds_are_not_ten_seconds() -> None:
    np.testing.assert_allclose(np.diff(seconds_of_counter(10.0 * np.arange(60), None).time), 0.01)


def test_repeated_stamps_do_not_change_the_unit_of_a_counter() -> None:
    """Microseconds at 100 Hz that were printed to the second: each stamp stands a hundred times."""
    clock = seconds_of_counter(1e6 * np.floor(np.arange(1000) / 100.0), None)
    assert clock.time[-1] == pytest.approx(9.0)
    grid = grid_of_coarse_stamps(clock.time)
    assert grid is not None and np.mean(np.diff(grid[0])) == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize("first", [45717.9, 739677.9])
def test_serial_days_of_a_calendar_are_days(first: float) -> None:
    clock = seconds_of_counter(first + np.arange(60) / 100.0 / 86400.0, None)
    np.testing.assert_allclose(clock.time, 0.01 * np.arange(60), atol=2e-5)


def test_a_rate_that_is_impossible_in_seconds_is_refused_with_a_remedy() -> None:
    with pytest.raises(
        RecordError, match=r"8\.64e\+06 samples a second, and no unit is stated.*unit = .h."
    ):
        seconds_of_counter(0.5 + np.arange(60) / 100.0 / 86400.0, None)


@pytest.mark.parametrize(
    ("stamps", "note"),
    [
        (5.0 * np.arange(60), "0.2 samples a second; if it is in ms"),
        (np.arange(60) / 6000.0, "if it is in min"),
    ],
)
def test_a_doubtful_rate_is_said(stamps: np.ndarray, note: str) -> None:
    clock = seconds_of_counter(stamps, None)
    assert note in " ".join(clock.notes)
    np.testing.assert_allclose(clock.time, stamps)


@pytest.mark.parametrize("period", [86400.0, 604800.0])
def test_seconds_of_a_day_or_a_week_go_on_after_its_end(period: float) -> None:
    true = period - 0.5 + 0.01 * np.arange(100)
    clock = seconds_of_counter(np.mod(true, period), "s")
    np.testing.assert_allclose(clock.time, true, atol=1e-9)
    assert "begins anew" in " ".join(clock.notes)


def test_stamps_of_a_calendar_count_from_the_first() -> None:
    clock = seconds_of_counter(1.7e9 + 0.5 * np.arange(5), None)
    np.testing.assert_allclose(clock.time, 0.5 * np.arange(5), atol=1e-6)
    assert clock.origin == pytest.approx(1.7e9)


@pytest.mark.long
@given(st.floats(0.01, 0.5), st.integers(2, 4), st.integers(200, 900), st.floats(0.0, 3.0))
def test_a_grid_that_was_printed_with_few_digits_is_recovered(
    step: float, digits: int, count: int, begin: float
) -> None:
    true = begin + step * np.arange(count)
    printed = np.array([float(f"{value:.{digits - 1}e}") for value in true])
    found = grid_of_coarse_stamps(printed)
    if found is None:
        steps = np.diff(printed)
        last = np.abs(printed) * 10.0 ** (1 - digits)
        if np.mean(np.abs(steps - np.median(steps)) > 0.01 * np.median(steps)) < ROUNDED_STEP_SHARE:
            return  # hardly any step is uneven
        assert np.max(np.abs(steps - steps.mean())) < 0.011 * step or last.max() < 0.11 * step
        return
    unit = 10.0 ** (np.floor(np.log10(np.abs(printed[-1]))) + 1 - digits)
    assert np.max(np.abs(found[0] - true)) <= unit
    assert np.mean(np.diff(found[0])) == pytest.approx(step, abs=2.0 * unit / count)


@pytest.mark.parametrize("rate", [16.0, 30.0, 33.0, 60.0, 64.0, 200.0])
def test_hundredths_of_a_second_hold_the_grid_of_any_rate(rate: float) -> None:
    """At 33 Hz 99 of 100 steps print as 0.03 s."""
    found = grid_of_coarse_stamps(np.round(12.3 + np.arange(900) / rate, 2))
    assert found is not None and np.mean(np.diff(found[0])) == pytest.approx(1.0 / rate, rel=1e-4)


@pytest.mark.parametrize("begin", [0.0, 1e-4, 5.0])
def test_uneven_times_below_a_second_are_kept(begin: float) -> None:
    """Times below one have no fewer digits than those above."""
    time = begin + np.round(0.05 * np.sin(0.02 * np.arange(60)), 6)
    assert grid_of_coarse_stamps(time) is None


def test_stamps_that_jitter_are_no_rounded_grid() -> None:
    rng = np.random.default_rng(3)
    time = np.round(0.02 * np.arange(500) + 0.004 * rng.standard_normal(500), 3)
    assert grid_of_coarse_stamps(np.sort(time)) is None


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["23:59:59.500", "00:00:00.000", "00:00:00.500"], [0.0, 0.5, 1.0]),
        (["059:23:59:59.75", "060:00:00:00.25"], [0.0, 0.5]),
        (
            ["2025-03-01 12:00:00.000+00:00", "", "2025-03-01 12:00:00.040+00:00"],
            [0.0, np.nan, 0.04],
        ),
        (["2025-03-30T01:59:59+01:00", "2025-03-30T03:00:00+02:00"], [0.0, 1.0]),
        (["01.03.2025 12:00:00", "01.03.2025 12:00:01"], [0.0, 1.0]),
        (["28.02.2025 23:59:59", "01.03.2025 00:00:01"], [0.0, 2.0]),
        (["03/01/2025 11:59:59.5 PM", "03/02/2025 12:00:00.5 AM"], [0.0, 1.0]),
        (["12/12/2025 23:59:59", "12/13/2025 00:00:00"], [0.0, 1.0]),
        (["2025:060:23:59:59.5", "2025:061:00:00:00.5"], [0.0, 1.0]),
        (["060-23:59:59.5", "061-00:00:00.5"], [0.0, 1.0]),
        (["0 days 00:00:59.500000", "1 days 00:00:00"], [0.0, 86340.5]),
        (["12:00:00:990", "12:00:01:010"], [0.0, 0.02]),
        (["59:59.9", "00:00.1"], [0.0, 0.2]),
    ],
    ids=[
        "midnight",
        "irig",
        "iso with a gap",
        "summer time",
        "day first",
        "day first, a month ends",
        "month first",
        "month first, both at the turn",
        "irig with a year",
        "irig with a dash",
        "durations of pandas",
        "a colon before milliseconds",
        "minutes of a spreadsheet",
    ],
)
def test_texts(texts: list[str], seconds: list[float]) -> None:
    clock = times_of_texts(texts)
    assert clock is not None and len(clock.notes) == 1
    np.testing.assert_allclose(clock.time, seconds, atol=1e-9)


@pytest.mark.parametrize("texts", [["nothing"], ["12:00"], ["12:00:00", "later"], [""], ["1.5"]])
def test_texts_that_are_no_times(texts: list[str]) -> None:
    assert times_of_texts(texts) is None


def test_dates_of_numpy() -> None:
    first = datetime.datetime(2026, 1, 1)
    dates = np.array(
        [first, first + datetime.timedelta(milliseconds=20), "NaT"], dtype="datetime64[ns]"
    )
    np.testing.assert_allclose(times_of_dates(dates).time, [0.0, 0.02, np.nan], atol=1e-12)
    np.testing.assert_allclose(times_of_dates(dates[:2] - dates[0]).time, [0.0, 0.02], atol=1e-12)


def test_rows_in_disorder() -> None:
    time = np.arange(100.0)
    swapped = time.copy()
    swapped[[40, 41]] = swapped[[41, 40]]
    found = sorted_rows(swapped, np.zeros(100, dtype=bool))
    assert found is not None and found.time.tolist() == time.tolist() and "sorted" in found.notes[0]
    assert sorted_rows(np.concatenate([time[50:], time[:50]]), np.zeros(100, dtype=bool)) is None
    repeated = np.sort(np.concatenate([time, [7.0]]))
    assert sorted_rows(repeated, np.zeros(101, dtype=bool)) is None
    repeats = np.zeros(101, dtype=bool)
    repeats[8] = True
    found = sorted_rows(repeated, repeats)
    assert found is not None and found.order.size == 100 and "1 row" in found.notes[0]


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("Time", True),
        ("TimeUS", True),
        ("time [s]", True),
        ("t (ms)", True),
        ("timer", False),
        ("theta", False),
    ],
)
def test_names_of_clocks(name: str, is_one: bool) -> None:
    assert is_clock(name) is is_one
