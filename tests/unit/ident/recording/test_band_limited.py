"""Channels whose noise ends at a cutoff, as filtering without phase and Fourier resampling leave
it; and those whose noise does not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.signal import butter, filtfilt, resample

from ident.recording.inspection import inspect
from ident.recording.series import Certainty, Kind, RecordFinding
from sim.record import Channel, Record
from tests.recorded_flight import Aircraft, altered, flight, rounded

ATTAS = Path(__file__).parents[5] / "shared" / "flightdata" / "aircraft" / "fAttasAil1.mat"
MEASURED = ("alpha", "q", "nz")


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(3), duration=20.0)


def filtered(record: Record) -> list[RecordFinding]:
    return [one for one in inspect(record, Aircraft().expected) if one.kind is Kind.FILTERED]


def both_ways(values: np.ndarray) -> np.ndarray:
    """A Butterworth filter of order 4 at 10 of 25 Hz, forwards and backwards."""
    return np.asarray(filtfilt(*butter(4, 0.4), values))


def through_analog(values: np.ndarray) -> np.ndarray:
    """A Butterworth filter of order 4 at 8 Hz before the converter, as recorders have against
    aliasing.
    """
    ramp = np.linspace(values[0], values[-1], values.size)
    frequency = np.fft.rfftfreq(values.size, 0.02)
    gain = 1.0 / np.polyval(butter(4, 1.0, analog=True)[1], 1j * frequency / 8.0)
    return ramp + np.fft.irfft(np.fft.rfft(values - ramp) * gain, values.size)


def test_a_channel_filtered_without_phase_is_noted_with_its_cutoff(sound: Record) -> None:
    (one,) = filtered(rounded(altered(sound, q=both_ways), q=1e-7))
    assert (one.channel, one.certainty) == (
        "q",
        Certainty.NOTED,
    ) and "filtered or resampled" in one.sentence
    assert one.numbers["cutoff"].value == pytest.approx(10.0, rel=0.15)


@pytest.mark.parametrize("factor", [1.25, 2.0, 4.0])
def test_channels_resampled_by_fourier_transform_are_noted(sound: Record, factor: float) -> None:
    count = int(len(sound) * factor)
    outputs = []
    for name in MEASURED:
        values = sound[name].values
        ramp = np.linspace(values[0], values[-1], values.size)
        fine = np.interp(np.arange(count) / factor, np.arange(values.size), ramp)
        outputs.append(Channel.of(name, sound[name].unit, fine + resample(values - ramp, count)))
    time = np.arange(count) * 0.02 / factor
    found = filtered(
        Record(
            time,
            (Channel.of("elevator", "rad", np.interp(time, sound.time, sound["elevator"].values)),),
            tuple(outputs),
        )
    )
    assert [one.channel for one in found] == list(MEASURED)
    assert [one.numbers["cutoff"].value for one in found] == pytest.approx([25.0] * 3, rel=0.15)


def test_sound_channels_and_a_filter_against_aliasing_are_not_noted(sound: Record) -> None:
    assert filtered(sound) == [] and filtered(rounded(sound, alpha=1e-3, q=2e-3, nz=0.02)) == []
    assert filtered(altered(sound, **dict.fromkeys(MEASURED, through_analog))) == []


def test_a_motion_without_noise_is_not_noted_where_its_input_ends_as_it_does() -> None:
    rng, time = np.random.default_rng(4), np.arange(1000) * 0.02
    moved = both_ways(rng.standard_normal(time.size))
    lagged = Channel.of(
        "q", "rad/s", np.convolve(moved, np.exp(-np.arange(50) / 10.0))[: time.size]
    )
    found = filtered(Record(time, (Channel.of("elevator", "rad", moved),), (lagged,)))
    assert [one.channel for one in found] == ["elevator"]


def test_a_measured_acceleration_that_was_differentiated_and_smoothed() -> None:
    if not ATTAS.is_file():
        pytest.skip("the measured record is not here")
    table = scipy.io.loadmat(ATTAS)["fAttasAil1"]
    outputs = tuple(
        Channel.of(name, "1", table[:, column])
        for name, column in (("p", 6), ("q", 7), ("r", 8), ("q_dot", 17))
    )
    assert [one.channel for one in filtered(Record(table[:, 0], (), outputs))] == ["q_dot"]
