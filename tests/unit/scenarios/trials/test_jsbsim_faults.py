"""Faults put into a JSBSim flight afterwards, against what they mean in words; no JSBSim needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.trials.jsbsim_declaration import (
    HAND_TRAVEL_TIME,
    SLOTS,
    JsbsimFlight,
    ahead_of_play,
    by_hand,
    commands,
    named,
    with_faults,
)

FLIGHT = JsbsimFlight(
    "f", "f", "", "c172x", 1500.0, 54.0, "lateral", "3-2-1-1", 1.0, 20.0, 50.0, 1.0, {}
)
TIME = np.arange(4001) / 400.0


def played(drive: np.ndarray, half: float, start: float) -> np.ndarray:
    """A surface behind a play, written a second way: it stays until the drive pulls it along."""
    surface, shown = start, []
    for u in drive:
        surface = min(max(surface, u - half), u + half)
        shown.append(surface)
    return np.array(shown)


@pytest.mark.parametrize("half", [0.002, 0.01])
def test_a_drive_ahead_of_play_moves_the_surface_as_it_moved(half: float) -> None:
    surface = 0.01 + by_hand(
        0.05 * ((TIME > 2) & (TIME < 4)) - 0.03 * ((TIME > 4) & (TIME < 5)) + 0.02 * (TIME > 8),
        TIME,
    )
    drive = ahead_of_play(surface, half)
    np.testing.assert_allclose(played(drive, half, surface[0]), surface, atol=1e-12)
    assert np.max(np.abs(drive - surface)) == pytest.approx(half)
    still = np.full(100, 0.3)
    np.testing.assert_array_equal(ahead_of_play(still, half), still)


def test_late_channels_and_late_surfaces() -> None:
    signals = {"time": TIME, "beta": np.sin(TIME), "rudder": np.sin(TIME)}
    shown = with_faults(signals, replace(FLIGHT, late={"beta": 0.1, "rudder": 0.05}))
    inner = slice(100, -100)
    np.testing.assert_allclose(shown["beta"][inner], np.sin(TIME - 0.1)[inner], atol=1e-5)
    # The aircraft's rudder is where its record was 0.05 s earlier.
    np.testing.assert_allclose(shown["rudder"][inner], np.sin(TIME + 0.05)[inner], atol=1e-5)


def test_vanes_ahead_feel_the_turning() -> None:
    ones = np.ones_like(TIME)
    signals = {
        "time": TIME,
        "alpha": 0.1 * ones,
        "beta": 0.0 * ones,
        "q": 0.2 * ones,
        "r": 0.2 * ones,
        "airspeed": 50.0 * ones,
    }
    shown = with_faults(signals, replace(FLIGHT, vane_ahead=5.0))
    assert shown["alpha"][0] == pytest.approx(0.1 - 0.02) and shown["beta"][0] == pytest.approx(
        0.02
    )
    assert with_faults(signals, FLIGHT)["alpha"] is signals["alpha"]


def test_what_was_put_in_has_the_names_of_the_library() -> None:
    flight = replace(
        FLIGHT,
        late={"rudder": 0.05, "p": 0.1},
        backlash={"aileron": 0.01},
        vane_ahead=3.0,
        rough_air=3,
    )
    assert list(named(flight)) == [
        "input-delay:rudder",
        "sensor-delay:p",
        "input-backlash:aileron",
        "vane-offset",
        "gust-turbulence",
    ]
    assert named(FLIGHT) == {}


@pytest.mark.parametrize("maneuver", ["3-2-1-1", "doublet", "multisine"])
@pytest.mark.parametrize("axis", list(SLOTS))
def test_maneuvers_begin_quietly_reach_their_size_and_come_back(axis: str, maneuver: str) -> None:
    sizes = dict.fromkeys(("elevator", "aileron", "rudder", "throttle"), 0.1)
    flight = replace(FLIGHT, axis=axis, maneuver=maneuver, duration=40.0)
    time = np.arange(16001) / 400.0
    found = commands(flight, sizes, dict.fromkeys(sizes, 0.6), time)
    assert set(found) == set(SLOTS[axis])
    for name, values in found.items():
        assert np.all(values[:800] == 0.0) and values[-1] == pytest.approx(0.0, abs=1e-9), name
        assert 0.07 < np.max(np.abs(values)) < 0.16
        assert np.max(np.abs(np.diff(values))) * 400.0 * HAND_TRAVEL_TIME < 0.25, (
            "a hand takes its time"
        )
