"""Channels that were interpolated between updates are told with their true rate; what resembles
them is left alone.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator

from ident.recording.inspection import inspect
from ident.recording.series import Certainty, Kind, RecordFinding
from sim.record import Channel, Record
from tests.recorded_flight import Aircraft, altered, flight, rounded


def resampled(
    record: Record, rate: float, curve: str, names: tuple[str, ...] = ("alpha", "q", "nz")
) -> Record:
    """Some channels logged at ``rate`` Hz and brought back to the record's own times."""
    slow = np.arange(0.0, record.time[-1] + 1e-9, 1.0 / rate)

    def of(values: np.ndarray) -> np.ndarray:
        logged = values[np.round(slow / np.median(np.diff(record.time))).astype(int)]
        if curve == "linear":
            return np.interp(record.time, slow, logged)
        return {"spline": CubicSpline, "pchip": PchipInterpolator}[curve](slow, logged)(record.time)

    return altered(record, **dict.fromkeys(names, of))


def interpolations(record: Record) -> list[RecordFinding]:
    return [one for one in inspect(record, Aircraft().expected) if one.kind is Kind.INTERPOLATED]


@pytest.mark.parametrize("curve", ["linear", "spline", "pchip"])
@pytest.mark.parametrize(("rate", "period"), [(10.0, 5), (5.0, 10)])
@pytest.mark.parametrize("printed", [False, True])
def test_an_interpolated_channel_is_told_with_its_rate(
    curve: str, rate: float, period: int, printed: bool
) -> None:
    """The bends of a smooth curve ten samples long are a thousandth of the noise: they show where
    more digits are printed.
    """
    record = resampled(flight(np.random.default_rng(5), duration=20.0), rate, curve, ("q",))
    record = rounded(record, q=1e-7 if curve == "linear" else 1e-9) if printed else record
    (one,) = interpolations(record)
    assert (one.channel, one.certainty) == ("q", Certainty.COSTS_INFORMATION)
    assert one.numbers["samples"].value == period and f"({rate:g} Hz)" in one.sentence
    kept = np.flatnonzero(~one.mask)
    assert np.all(kept % period == 0) and len(kept) >= len(record) // period


@pytest.mark.parametrize("rate", [25.0, 16.0])
def test_straight_lines_between_close_or_uneven_updates_are_told(rate: float) -> None:
    record = flight(np.random.default_rng(6), duration=20.0, outputs=("alpha", "q"))
    slow = np.arange(0.0, record.time[-1] + 1.0 / rate, 1.0 / rate)
    rng = np.random.default_rng(7)
    logged = np.interp(slow, record.time, record["q"].values) + 0.003 * rng.standard_normal(
        len(slow)
    )
    found = interpolations(altered(record, q=lambda _: np.interp(record.time, slow, logged)))
    (one,) = found
    assert one.numbers["period"].value == pytest.approx(1.0 / rate, rel=0.1)


def test_an_input_is_only_noted() -> None:
    time = np.arange(1000) / 50.0
    slow = np.arange(0.0, 20.1, 0.1)
    rng = np.random.default_rng(8)
    moved = np.interp(
        time, slow, 0.05 * np.sin(2.0 * slow) + 0.002 * rng.standard_normal(len(slow))
    )
    record = Record(
        time,
        (Channel.of("elevator", "rad", moved),),
        (Channel.of("q", "rad/s", 0.003 * rng.standard_normal(1000)),),
    )
    (one,) = interpolations(record)
    assert (one.channel, one.certainty, one.count) == ("elevator", Certainty.NOTED, 0)


@pytest.mark.sampled
@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("kind", ["3211", "steps", "doublets"])
@pytest.mark.parametrize("bit", [0.0, 1e-6, 1e-3])
def test_motion_and_noise_are_no_interpolation(noise: float, kind: str, bit: float) -> None:
    record = flight(np.random.default_rng(9), kind=kind, duration=20.0, noise=noise)
    assert interpolations(rounded(record, q=bit, alpha=bit) if bit else record) == []


def test_the_sum_of_an_input_that_a_computer_steps_is_no_interpolation() -> None:
    """A position under a stepped velocity is straight between its steps, and measured at every
    sample.
    """
    time = np.arange(1000) / 50.0
    velocity = np.repeat(np.random.default_rng(10).standard_normal(200), 5)
    position = np.concatenate([[0.0], np.cumsum(0.02 * velocity)[:-1]])
    assert (
        interpolations(
            Record(time, (Channel.of("u", "1", velocity),), (Channel.of("x", "m", position),))
        )
        == []
    )
