"""Stepping with limits: modes of the rams, stops, and limits that are met only for an instant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.closed_loop.airframe import load_x29
from sim.closed_loop.equations import ALL_FREE, RamMode, Stepper, advance, plant, prepare

X29 = load_x29("S")
PLANT = plant(X29)
SPAN = 0.0125
COARSE, FINE = prepare(X29, PLANT, SPAN, 1), prepare(X29, PLANT, SPAN, 32)
FINER = prepare(X29, PLANT, SPAN, 256)
# State positions: canard servo and ram, flaperon servo and ram, strake ram; then the three commands
# and the 1.
CANARD_SERVO, CANARD, FLAPERON_SERVO, FLAPERON, STRAKE = 2, 4, 5, 7, 8
COMMANDS = slice(13, 16)


def state_with(**values: float) -> np.ndarray:
    positions = {
        "canard_servo": CANARD_SERVO,
        "canard": CANARD,
        "flaperon_servo": FLAPERON_SERVO,
        "flaperon": FLAPERON,
        "strake": STRAKE,
    }
    state = np.zeros(17)
    state[-1] = 1.0
    for name, value in values.items():
        state[positions[name]] = value
    # Commands at rest with the servos.
    state[COMMANDS] = state[CANARD_SERVO], state[FLAPERON_SERVO], 0.0
    return state


@pytest.mark.parametrize("stepper", [COARSE, FINE])
def test_ram_runs_at_its_rate_until_it_is_close_then_follows_its_lag(stepper: Stepper) -> None:
    # From 0.6 deg below the strake's end of rate limiting: 30 deg/s for 20 ms, an exponential from
    # there.
    boundary = 30.0 / 20.2
    state, modes = state_with(strake=-(boundary + 0.6)), ALL_FREE
    seen_modes = []
    for _ in range(4):
        state, modes, seen = advance(stepper, state, modes)
        seen_modes.append([active[2] for active in seen])
    after = 4 * SPAN - 0.6 / 30.0
    assert state[STRAKE] == pytest.approx(-boundary * np.exp(-20.2 * after), rel=1e-9)
    assert seen_modes == [[RamMode.RATE_UP], [RamMode.RATE_UP, RamMode.FREE], [], []]


@pytest.mark.parametrize(
    ("end", "mode"), [(19.75, RamMode.STOP_UPPER), (-15.0, RamMode.STOP_LOWER)]
)
def test_ram_stops_at_the_end_of_its_travel_and_leaves_it(end: float, mode: RamMode) -> None:
    # A servo held 1 deg beyond the travel for a span, then back within it.
    sign = np.sign(end)
    state = state_with(flaperon_servo=end + sign, flaperon=end - sign * 0.1)
    state, modes, seen = advance(FINE, state, ALL_FREE)
    assert [active[1] for active in seen] == [RamMode.FREE, mode]
    assert state[FLAPERON] == end and modes[1] is mode
    state[FLAPERON_SERVO] = state[14] = end - sign
    state, modes, seen = advance(FINE, state, modes)
    assert modes == ALL_FREE and state[FLAPERON] == pytest.approx(
        end - sign * (1.0 - np.exp(-20.2 * SPAN)), rel=1e-9
    )


def test_a_limit_met_and_left_within_a_piece_costs_little() -> None:
    # The canard's servo swings out and back; its ram's rate tops its limit by 1 % for about a
    # millisecond.
    state = state_with()
    state[CANARD_SERVO + 1] = 300.0
    small, rates, moved = prepare(X29, PLANT, SPAN / 500, 1), [], state
    for _ in range(3000):
        moved, _, _ = advance(small, moved, ALL_FREE)
        rates.append(20.2 * (moved[CANARD_SERVO] - moved[CANARD]))
    limited = replace(
        X29, surfaces=(replace(X29.surfaces[0], rate=0.99 * max(rates)), *X29.surfaces[1:])
    )

    def end(pieces: int) -> tuple[float, bool]:
        stepper, at, modes, met = prepare(limited, PLANT, SPAN, pieces), state, ALL_FREE, False
        for _ in range(6):
            at, modes, seen = advance(stepper, at, modes)
            met |= any(active[0] is RamMode.RATE_UP for active in seen)
        return float(at[CANARD]), met

    exact, met = end(512)
    assert met and end(64)[1]
    assert end(64)[0] == pytest.approx(exact, abs=1e-10)
    # Unseen, all of it costs 1 % of the rate for that time.
    assert abs(end(1)[0] - exact) < 0.01 * max(rates) * 0.002


@given(
    servo=st.floats(-25.0, 25.0),
    ram=st.floats(-15.0, 19.75),
    strake=st.floats(-30.0, 30.0),
    command=st.floats(-15.0, 19.75),
)
def test_rams_obey_rate_and_travel_and_finer_pieces_change_nothing(
    servo: float, ram: float, strake: float, command: float
) -> None:
    state = state_with(flaperon_servo=servo, flaperon=ram, strake=strake)
    state[14] = command
    fine, fine_modes = state, ALL_FREE
    for _ in range(6):
        before = fine
        fine, fine_modes, _ = advance(FINE, fine, fine_modes)
        for row, rate, low, high in ((FLAPERON, 68.0, -15.0, 19.75), (STRAKE, 30.0, -30.0, 30.0)):
            assert abs(fine[row] - before[row]) <= rate * SPAN * (1.0 + 1e-7)
            assert low - 1e-7 <= fine[row] <= high + 1e-7
    finer, _, _ = advance(FINER, state, ALL_FREE)
    once, _, _ = advance(FINE, state, ALL_FREE)
    np.testing.assert_allclose(once, finer, atol=1e-5)
