"""Streams with multisines: flights against second writings, counts of histories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from exam.coverage.frequency_responses import (
    loes_stream,
    roll_loop,
    swept_roll_loop,
    true_bandwidth,
)
from exam.coverage.streams import (
    OWN,
    PERIOD,
    clean_stream,
    histories,
    multisines,
    own_motion,
    stream,
    watched,
)
from ident.frequency_domain.online import frequencies
from scenarios.files.vehicles import VehicleFile
from scenarios.trials.sweeps import true_loop
from scenarios.watching.spectral import regress, spectral_session, take


def test_multisines_are_orthogonal_and_as_large_as_asked() -> None:
    time = np.arange(round(PERIOD * 50)) / 50.0
    rows = multisines(time, [0.02, 0.5])
    np.testing.assert_allclose(np.sqrt(np.mean(rows**2, axis=1)), [0.02, 0.5], rtol=1e-12)
    assert abs(float(rows[0] @ rows[1])) < 1e-9 * time.size
    # Schroeder's phases keep the peak below that of a single sine times the root of two.
    assert np.abs(rows).max(axis=1)[0] < 2.0 * math.sqrt(2.0) * 0.02


@pytest.mark.parametrize("name", list(OWN))
def test_a_users_motion_is_that_of_its_equations(name: str) -> None:
    time = np.arange(200) / 50.0
    moved = np.repeat(np.random.default_rng(1).normal(size=20), 10)
    matrix = np.array(OWN[name].rates(OWN[name].true.__getitem__))
    fine = np.arange(200 * 100) / 5000.0
    _, states, _ = signal.lsim(
        (matrix[:, :2], matrix[:, 2:], np.eye(2), np.zeros((2, 1))),
        np.repeat(moved, 100),
        fine,
        interp=False,
    )
    np.testing.assert_allclose(own_motion(name, time, moved), states[::100].T, atol=1e-9)


def test_histories_are_counted() -> None:
    vehicle, rows, true = stream("own", 1)
    names = ("beta", "r")
    session = spectral_session(vehicle, "stream", names, frequencies())
    take(session, rows)
    regress(session)
    held = histories(session, true)
    assert held["at the end"][1] == len(true) == 4
    assert held["every second"][1] >= 4 * (len(session.points) - 2) > 80
    assert watched("own", 1) == held
    far = histories(session, {name: value + 100.0 for name, value in true.items()})
    assert far["every second"][0] == far["at the end"][0] == 0


@pytest.mark.long
def test_streams_have_the_channels_of_their_models() -> None:
    # The rigid aircraft could use an airspeed and a dynamic pressure, which these streams lack.
    for model, count in (("rigid", 2 + 3 + 2), ("lateral", 3 + 5), ("longitudinal", 3 + 6)):
        _, rows, true = stream(model, 2)
        assert np.all(np.isnan(rows[5:])) or model != "rigid"
        time, inputs, outputs = clean_stream(model)
        assert rows.shape == (count, time.size) and set(true)
        np.testing.assert_array_equal(rows[1 : 1 + len(inputs)], inputs)
        assert all(np.ptp(each) > 0.0 for each in outputs.values())


def test_known_bandwidths_are_those_of_the_continuous_short_period() -> None:
    """By the transfer function and the hold of half a sample, not by its sampled form."""
    from exam.coverage.frequency_responses import LATE, SHORT_PERIOD, STEP

    omega = np.geomspace(0.5, 20.0, 200001)
    _, rate = signal.freqs(*SHORT_PERIOD, omega)
    attitude = rate * np.exp(-1j * omega * STEP * (LATE + 0.5)) / (1j * omega)
    phase = np.degrees(np.unwrap(np.angle(attitude)))
    known = true_bandwidth()
    neutral = omega[np.argmax(phase <= -180.0)]
    assert known["frequency of -180 deg"] == pytest.approx(neutral, rel=2e-3)
    assert known["phase bandwidth"] == pytest.approx(omega[np.argmax(phase <= -135.0)], rel=2e-3)
    level = 20.0 * np.log10(np.abs(attitude[np.argmax(phase <= -180.0)])) + 6.0
    gain = omega[np.argmax(20.0 * np.log10(np.abs(attitude)) <= level)]
    assert known["gain bandwidth"] == pytest.approx(gain, rel=5e-3)


@pytest.mark.long
def test_crossings_of_the_roll_loop_lie_on_it() -> None:
    scenario, known = roll_loop()
    at = np.array([known["gain crossing"], known["phase crossing"]])
    loop = true_loop(scenario, at)
    assert abs(loop[0]) == pytest.approx(1.0, abs=1e-9)
    assert math.degrees(np.angle(-loop[0])) == pytest.approx(known["phase_margin"], abs=1e-3)
    assert loop[1].imag == pytest.approx(0.0, abs=1e-9) and loop[1].real < 0.0
    assert -20.0 * math.log10(abs(loop[1])) == pytest.approx(known["gain_increase"], abs=1e-3)
    held = swept_roll_loop("", 3)
    assert {"gain crossing", "phase crossing", "gain_increase", "distance"} <= set(held)
    assert all(count == 1 for _, count in held.values())


@pytest.mark.long
def test_a_low_order_stream_and_its_bank() -> None:
    held = loes_stream("", 1)
    assert held["regression, at the end"][1] == held["bank, at the end"][1] == 8
    assert held["one another, two deviations"][0] >= 6


def test_a_stream_takes_the_vehicle_file_of_a_user() -> None:
    vehicle, _, true = stream("f16-unstable", 0)
    assert isinstance(vehicle, VehicleFile) and vehicle.own is not None
    assert true["M_alpha"] == 1.0 and true["M_de"] == -5.157
    assert all(0.7 <= vehicle.derivatives[name] / value <= 1.3 for name, value in true.items())
