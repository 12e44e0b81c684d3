"""Noise that changes, hum, and zeros that step; and what is none of these."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.recording.distorted_channels import _jumps
from ident.recording.inspection import inspect
from ident.recording.series import Certainty, Kind, RecordFinding, _loud_samples
from sim.record import Channel, Record
from tests.recorded_flight import SIGMAS, UNITS, Aircraft, altered, flight

SHARED = Path(__file__).parents[5] / "shared"


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(11), duration=20.0)


def warned(record: Record) -> list[RecordFinding]:
    told = inspect(record, Aircraft().expected)
    assert all(one.certainty is Certainty.LIKELY for one in told), [one.sentence for one in told]
    return list(told)


@pytest.mark.parametrize("channel", ["alpha", "q", "nz"])
def test_noise_that_becomes_twice_as_loud_is_warned_of(sound: Record, channel: str) -> None:
    rng, half = np.random.default_rng(1), np.arange(len(sound)) > 0.6 * len(sound)
    (one,) = warned(
        altered(
            sound,
            **{channel: lambda v: v + 2.6 * SIGMAS[channel] * rng.standard_normal(len(v)) * half},
        )
    )
    assert (one.channel, one.kind) == (channel, Kind.NOISE_LEVEL) and one.count == 0
    assert one.times[0][0] > 11.0 and one.numbers["least"].value == pytest.approx(
        SIGMAS[channel], rel=0.3
    )


@pytest.mark.parametrize("channel", ["alpha", "q", "nz"])
def test_a_burst_of_six_times_the_noise_is_set_aside(sound: Record, channel: str) -> None:
    rng, loud = np.random.default_rng(1), (sound.time > 5.0) & (sound.time < 9.0)
    found = inspect(
        altered(
            sound,
            **{channel: lambda v: v + 6.0 * SIGMAS[channel] * rng.standard_normal(len(v)) * loud},
        )
    )
    (one,) = [each for each in found if each.kind is Kind.NOISE_LEVEL]
    assert (one.channel, one.certainty) == (channel, Certainty.COSTS_INFORMATION)
    assert np.mean(one.mask[loud]) > 0.9 and np.mean(one.mask[~loud]) < 0.05


def test_the_same_samples_are_loud_when_time_runs_backwards() -> None:
    """A fourth difference belongs to the middle one of its five samples."""
    values = np.random.default_rng(2).standard_normal(600) * np.where(
        np.arange(600) // 200 == 1, 6.0, 1.0
    )
    forwards = _loud_samples(np.diff(values, 4) / math.sqrt(70.0), 2.5, 600)
    backwards = _loud_samples(np.diff(values[::-1], 4) / math.sqrt(70.0), 2.5, 600)
    np.testing.assert_array_equal(backwards[::-1], forwards)
    at = np.flatnonzero(forwards)
    assert abs(at[0] - 200) < 15 and abs(at[-1] - 399) < 15 and len(at) == at[-1] - at[0] + 1


def test_noise_that_is_loud_most_of_the_time_is_warned_of_and_kept(sound: Record) -> None:
    rng, loud = np.random.default_rng(1), sound.time > 0.3 * sound.time[-1]
    (one,) = warned(
        altered(sound, q=lambda v: v + 6.0 * SIGMAS["q"] * rng.standard_normal(len(v)) * loud)
    )
    assert one.kind is Kind.NOISE_LEVEL and one.count == 0


@pytest.mark.parametrize("frequency", [9.0, 17.3, 23.0])
@pytest.mark.parametrize("channel", ["alpha", "q", "nz"])
def test_a_hum_is_told_with_frequency_and_amplitude(
    sound: Record, channel: str, frequency: float
) -> None:
    size = 1.5 * SIGMAS[channel]
    (one,) = warned(
        altered(
            sound,
            **{channel: lambda v: v + size * np.sin(2.0 * math.pi * frequency * sound.time + 0.3)},
        )
    )
    assert (one.channel, one.kind) == (channel, Kind.HUM)
    assert one.numbers["frequency"].value == pytest.approx(frequency, abs=0.01)
    assert one.numbers["amplitude"].value == pytest.approx(size, rel=0.2)


def test_a_hum_above_half_the_sample_rate_shows_below_it(sound: Record) -> None:
    (one,) = warned(
        altered(sound, q=lambda v: v + 0.006 * np.sin(2.0 * math.pi * 60.0 * sound.time))
    )
    assert (
        one.numbers["frequency"].value == pytest.approx(10.0, abs=0.01) and "25 Hz" in one.sentence
    )


def test_structure_that_rings_or_is_shaken_is_no_hum(sound: Record) -> None:
    time, rng = sound.time, np.random.default_rng(2)
    steps = np.flatnonzero(np.diff(sound.inputs[0].values))
    omega, damping = 2.0 * math.pi * 8.0, 0.02
    ringing = sum(
        np.exp(-damping * omega * late) * np.sin(omega * late) * (late > 0.0)
        for late in (time - time[k] for k in steps)
    )
    shaken, a, b = np.zeros(len(time)), 2.0 * 0.98 * math.cos(omega * 0.02), -(0.98**2)
    for k in range(2, len(time)):
        shaken[k] = a * shaken[k - 1] + b * shaken[k - 2] + rng.standard_normal()
    for motion in (0.02 * np.asarray(ringing), 0.01 * shaken / np.std(shaken)):
        assert all(one.kind is not Kind.HUM for one in inspect(altered(sound, q=motion.__add__)))


def test_harmonics_of_a_periodic_input_are_no_hum() -> None:
    record = flight(np.random.default_rng(3), kind="steps", duration=30.0, noise=0.1, rate=80.0)
    assert inspect(record) == ()


def test_a_line_of_the_input_is_no_hum_of_a_channel_of_a_lower_rate() -> None:
    time, rng = 0.01 * np.arange(4000), np.random.default_rng(6)
    line = 0.02 * np.sin(2.0 * math.pi * 9.0 * time)
    slow = np.where(np.arange(4000) % 3 == 0, line + 0.003 * rng.standard_normal(4000), np.nan)
    driven = Record(time, (Channel.of("elevator", "rad", line),), (Channel.of("q", "rad/s", slow),))
    assert all(one.kind is not Kind.HUM for one in inspect(driven))
    (one,) = inspect(replace(driven, inputs=()))
    assert one.kind is Kind.HUM


@pytest.mark.parametrize("channel", ["alpha", "q", "nz"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["3211", "sweep"])
def test_a_zero_that_steps_is_told_with_time_and_size(channel: str, sign: float, kind: str) -> None:
    record = flight(np.random.default_rng(4), kind=kind, duration=20.0)
    size = sign * 20.0 * SIGMAS[channel]
    (one,) = warned(altered(record, **{channel: lambda v: v + size * (np.arange(len(v)) >= 613)}))
    assert (one.channel, one.kind) == (channel, Kind.ZERO_STEP)
    assert one.times[0][0] == pytest.approx(record.time[613], abs=0.03)
    assert one.numbers["step"].value == pytest.approx(size, rel=0.25)


@pytest.mark.parametrize("length", [5, 12, 25])
def test_a_jump_forgets_level_slope_and_curvature_and_keeps_its_size(length: int) -> None:
    """Two lines to the middle between samples; a step at another row is seen in part, which is
    least where it is farthest.
    """
    rows, at, size = np.arange(120.0), 60, 0.4
    assert np.max(np.abs(_jumps(3.0 - 0.2 * rows, length))) < 1e-12
    assert np.max(np.abs(_jumps(0.01 * (rows - 60.0) ** 2, length))) < 1e-10 * 36.0
    found = _jumps(3.0 - 0.2 * rows + 0.01 * (rows - 60.0) ** 2 + size * (rows >= at), length)
    assert found[at - length] == pytest.approx(size) and np.argmax(np.abs(found)) == at - length
    assert np.max(np.abs(np.delete(found, np.s_[at - 2 * length + 1 : at]))) < 1e-9


def test_what_jumps_in_two_channels_or_returns_is_no_step_of_a_zero(sound: Record) -> None:
    after = np.arange(len(sound)) >= 613
    gust = altered(sound, alpha=lambda v: v + 0.03 * after, nz=lambda v: v + 0.37 * after)
    assert inspect(gust) == ()
    brief = after & (np.arange(len(sound)) < 616)
    assert inspect(altered(sound, q=lambda v: v + 0.1 * brief)) == ()


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    scale=st.floats(1e-6, 1e6),
    offset=st.floats(-1e3, 1e3),
    rate=st.sampled_from([10.0, 25.0, 50.0, 200.0]),
    ratio=st.floats(0.0, 100.0),
)
def test_white_noise_on_smooth_motion_shows_nothing_at_any_scale(
    seed: int, scale: float, offset: float, rate: float, ratio: float
) -> None:
    """Independent channels below 1 Hz, whatever their unit: no relation is asked of channels that
    no kinematics join.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(400) / rate
    channels = []
    for name in ("airspeed", "ax", "altitude"):
        motion = sum(
            rng.standard_normal()
            * np.sin(2.0 * math.pi * rng.uniform(0.05, 0.8) * time + rng.uniform(0.0, 6.0))
            for _ in range(4)
        )
        channels.append(
            Channel.of(
                name, "1", scale * (offset + ratio * motion + rng.standard_normal(len(time)))
            )
        )
    assert inspect(Record(time, (), tuple(channels))) == ()


def test_a_load_that_nothing_recorded_is_told_from_a_zero_of_nz_by_the_path_of_alpha() -> None:
    """A lift that comes at once and stays bends the path of alpha by (g/V) times the jump of nz; a
    zero does not.
    """
    craft = Aircraft()
    record = flight(np.random.default_rng(5), craft, duration=20.0)
    size, after = 0.3, np.maximum(record.time - record.time[613], 0.0)
    pushed = altered(
        record,
        nz=lambda v: v + size * (after > 0.0),
        alpha=lambda v: v - 9.80665 / craft.airspeed * size * np.minimum(after, 0.8),
    )
    assert all(one.kind is not Kind.ZERO_STEP for one in inspect(pushed, craft.expected))
    (one,) = warned(altered(record, nz=lambda v: v + size * (after > 0.0)))
    assert (one.channel, one.kind) == ("nz", Kind.ZERO_STEP)


LIGHT = Aircraft(
    lift=8.0, stiffness=-250.0, damping=-14.0, power=-220.0, elevator_lift=0.6, airspeed=11.0
)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["3211", "doublets"])
def test_a_maneuver_as_quick_as_the_samples_is_no_noise(seed: int, kind: str) -> None:
    """A light model aircraft of 16 rad/s at 10 Hz, which moves at the begin and rests
    afterwards.
    """
    record = flight(np.random.default_rng(seed), LIGHT, kind, rate=10.0, duration=4.0, size=0.07)
    rest = flight(np.random.default_rng(seed + 100), LIGHT, "rest", rate=10.0, duration=11.0)
    time = 0.1 * np.arange(len(record) + len(rest))
    joined = [
        Channel.of(a.name, a.unit, np.concatenate([a.values, b.values]))
        for a, b in zip(record.channels, rest.channels, strict=True)
    ]
    assert all(
        one.kind is not Kind.NOISE_LEVEL
        for one in inspect(Record(time, (joined[0],), tuple(joined[1:])), LIGHT.expected)
    )


def test_a_rate_that_makes_a_late_angle_rough_is_no_noise() -> None:
    """An attitude read up to half a sample late is rough as its rate is: at the turns, not at
    rest.
    """
    rng, time = np.random.default_rng(4), 0.04 * np.arange(750)
    rate = np.where(
        (time > 8.0) & (time < 16.0), 0.5 * np.sin(2.0 * math.pi * 0.25 * (time - 8.0)), 0.0
    )
    angle = (
        np.cumsum(rate) * 0.04
        + rate * 0.02 * rng.uniform(-1.0, 1.0, len(time))
        + 1e-4 * rng.standard_normal(len(time))
    )
    assert all(
        one.kind is not Kind.NOISE_LEVEL
        for one in inspect(Record(time, (), (Channel.of("phi", "rad", angle),)))
    )


def test_roughness_that_outputs_share_is_the_air_and_that_of_one_is_its_sensor(
    sound: Record,
) -> None:
    rng, loud = np.random.default_rng(5), (sound.time > 10.0) & (sound.time < 15.0)
    louder = {
        name: lambda v, sigma=SIGMAS[name]: v + 6.0 * sigma * rng.standard_normal(len(v)) * loud
        for name in ("alpha", "q", "nz")
    }
    assert all(one.kind is not Kind.NOISE_LEVEL for one in inspect(altered(sound, **louder)))
    (one,) = [
        each for each in inspect(altered(sound, q=louder["q"])) if each.kind is Kind.NOISE_LEVEL
    ]
    assert one.channel == "q"


def test_the_reported_maneuver_is_no_noise() -> None:
    path = SHARED / "cases" / "maneuver-as-noise" / "small.csv"
    if not path.is_file():
        pytest.skip("the reported record is not here")
    time, elevator, *columns = np.loadtxt(path, delimiter=",", skiprows=1).T
    outputs = tuple(
        Channel.of(name, UNITS[name], values)
        for name, values in zip(("alpha", "q", "nz"), columns, strict=True)
    )
    assert all(
        one.kind is not Kind.NOISE_LEVEL
        for one in inspect(Record(time, (Channel.of("elevator", "rad", elevator),), outputs))
    )


@pytest.mark.parametrize("name", ["fAttasAil1", "fAttasRud1"])
def test_a_measured_bank_angle_is_neither_stuck_nor_of_changing_noise(name: str) -> None:
    path = SHARED / "flightdata" / "aircraft" / f"{name}.mat"
    if not path.is_file():
        pytest.skip("the measured record is not here")
    content = scipy.io.loadmat(path)
    table = next(value for key, value in content.items() if not key.startswith("_"))
    outputs = tuple(
        Channel.of(channel, "rad", np.radians(table[:, column]))
        for channel, column in (("p", 6), ("r", 8), ("phi", 9), ("beta", 13))
    )
    record = Record(table[:, 0], (Channel.of("rudder", "rad", np.radians(table[:, 29])),), outputs)
    assert all(one.certainty is Certainty.NOTED for one in inspect(record)), [
        (one.channel, one.sentence) for one in inspect(record)
    ]


@pytest.mark.parametrize("name", ["fAttasAil1", "fAttasRud1", "fAttasAilRud2"])
def test_a_measured_angle_of_attack_brought_to_the_center_of_gravity_is_not_held(name: str) -> None:
    """Its converter's count repeats by chance, in 6 to 10 % of the samples where it rests and never
    where it moves fast.
    """
    path = SHARED / "flightdata" / "aircraft" / f"{name}.mat"
    if not path.is_file():
        pytest.skip("the measured record is not here")
    content = scipy.io.loadmat(path)
    table = next(value for key, value in content.items() if not key.startswith("_"))[:751]
    outputs = tuple(
        Channel.of(channel, "rad", np.radians(table[:, column]))
        for channel, column in (("p", 6), ("q", 7), ("alpha", 12))
    )
    aileron = Channel.of("aileron", "rad", np.radians(table[:, 27] - table[:, 28]))
    assert all(
        one.certainty is Certainty.NOTED
        for one in inspect(Record(table[:, 0], (aileron,), outputs))
    )
