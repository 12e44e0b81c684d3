"""Moving masses, wakes, engines and sensors outside the library, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tests.independent.checks.test_foreign_terms import FRESH, SHORT, STILL, now_of, rows, term_of
from tests.independent.flight import Flight
from tests.independent.foreign import controls, masses, sensors, surroundings
from tests.independent.foreign.simulator import STEP, Term, flown_with
from tests.independent.maneuvers import Maneuver, Pulse
from tests.independent.recording import USUAL
from tests.independent.short_period import FIGHTER, TRAINER

LONG = Maneuver((Pulse(0.5, 0.5, 0.0),), 40.0)


def followed(term: Term, seconds: float, **motion: float) -> np.ndarray:
    """Own states over time while the aircraft is held in one state, by small Euler-Cromer steps:
    rates first, then places with the new rates.
    """
    h, state, seen = 2e-4, np.array(term.start), []
    for _ in range(round(seconds / h)):
        rates = term.rates(now_of(TRAINER, own=tuple(state), **motion))
        if len(state) == 2:
            going = state[1] + h * rates[1]
            state = np.array([state[0] + h * going, going])
        else:
            state = state + h * rates
        seen.append(state)
    return np.array(seen)


def flight_of(alpha: np.ndarray, elevator: np.ndarray | None = None) -> Flight:
    zero = np.zeros_like(alpha)
    return Flight(
        STEP,
        zero if elevator is None else elevator,
        alpha,
        zero,
        zero + 1.0,
        zero,
        zero + 100.0,
        100.0,
    )


def test_a_load_slides_beyond_its_friction_and_stops_at_the_ends() -> None:
    term = term_of(masses.payload_slides, 0.02, TRAINER)
    assert np.all(followed(term, 0.5, alpha=np.radians(0.6)) == 0.0), "friction holds it"
    assert np.all(followed(term, 0.5, alpha=np.radians(-5.0)) == 0.0), "it lies at the forward stop"
    # one degree beyond the friction: the whole way in a second
    slid = followed(term, 1.5, alpha=np.radians(1.7))
    assert slid[round(0.5 / 2e-4) - 1, 0] == pytest.approx(0.5, rel=1e-6) and slid[
        -1, 0
    ] == pytest.approx(1.0, abs=1e-3)
    assert term.loads(now_of(TRAINER, own=(1.0,), load=1.2))[1] == pytest.approx(
        0.02 * 1.2 * masses.trim_lift(TRAINER)
    )


def test_rocking_pitches_the_nose_by_its_mean_and_takes_lift_from_the_weight() -> None:
    size, rate = 0.3, 1.8
    term = term_of(masses.inertia_coupling, size, TRAINER)
    times = 20.0 + np.arange(2000) / 2000.0 * 2.0 * np.pi / rate
    pitched = TRAINER.moment_slope * np.mean(
        [term.loads(now_of(TRAINER, time=float(t)))[1] for t in times]
    )
    # p r = A cos(x) s A sin(x + 0.6), whose mean is s A^2 sin(0.6)/2.
    assert pitched == pytest.approx(0.8 * 0.35 * (size * rate) ** 2 * np.sin(0.6) / 2.0, rel=1e-6)
    assert (
        max(term.bank(float(t)) for t in times) == pytest.approx(size, rel=1e-4)
        and term.bank(0.0) == 0.0
    )
    banked = flown_with(FIGHTER, STILL, 0.0, Term(bank=lambda time: 0.5))
    # Before alpha has followed, the path falls as if the weight's part across it were all that the
    # lift meets.
    early = round(0.02 / STEP)
    assert np.gradient(banked.alpha, STEP)[early] == pytest.approx(
        -9.80665 / FIGHTER.airspeed * (1.0 - np.cos(0.5)), rel=0.03
    )


@pytest.mark.long
def test_a_store_reaches_the_limit_cycle_and_dies_out_below_it() -> None:
    swings = followed(term_of(masses.store_flutter, 0.12, TRAINER), 12.0, alpha=np.radians(2.0))[
        :, 0
    ]
    last = swings[-round(2.0 / 2e-4) :]
    assert float(np.max(last)) == pytest.approx(2.0, rel=0.03), "van der Pol's amplitude"
    assert np.sum(np.diff(np.sign(last)) != 0) == pytest.approx(2 * 3.0 * 2.0, abs=1), (
        "three swings a second"
    )
    damped = followed(term_of(masses.store_flutter, 0.12, TRAINER), 6.0, alpha=np.radians(-3.0))[
        :, 0
    ]
    assert float(np.max(np.abs(damped[-2000:]))) < 0.01


def test_a_hunting_engine_swings_the_aircraft_by_its_frequency_response() -> None:
    flight = flown_with(FIGHTER, LONG, 0.0, term_of(controls.engine_surge, 0.05, FIGHTER))
    alpha_rate, q_rate, _ = rows(FIGHTER)
    surge = 2.0 * np.pi * 0.55
    matrix = np.stack([alpha_rate[:2], q_rate[:2]])
    answer = np.linalg.solve(1j * surge * np.eye(2) - matrix, np.array([alpha_rate[4], q_rate[4]]))
    late = flight.time > 40.0 - 2.0 * 2.0 * np.pi / surge
    swing = 0.05 * np.radians(1.0) * abs(FIGHTER.derivatives["Cm_de"]) * np.abs(answer)
    assert 0.5 * np.ptp(flight.q[late]) == pytest.approx(swing[1], rel=0.01)
    assert 0.5 * np.ptp(flight.alpha[late]) == pytest.approx(swing[0], rel=0.01)


def test_two_vortices_lift_outside_sink_between_and_sum_to_nothing() -> None:
    time = np.linspace(-400.0, 400.0, 800001)
    speed = np.asarray(surroundings.pair(time))
    assert np.all(speed[np.abs(time) < 0.45] < 0.0) and np.all(speed[np.abs(time) > 0.6] > 0.0)
    np.testing.assert_allclose(speed, speed[::-1], atol=1e-12)
    alone = 2.0 * np.sqrt(0.15**2 + 0.12**2) * time / (time**2 + 0.15**2 + 0.12**2)
    assert float(np.max(alone)) == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_allclose(
        speed, np.interp(time - 0.5, time, alone) - np.interp(time + 0.5, time, alone), atol=2e-3
    )
    # The two circulations cancel: what is left of the integral is the tail beyond the window.
    assert abs(np.sum(speed) * (time[1] - time[0])) < 0.01


def test_a_wake_meets_the_vane_before_the_aircraft_has_moved() -> None:
    flight = flown_with(FIGHTER, STILL, 0.0, term_of(surroundings.vortex_wake, 1.0, FIGHTER))
    level = Term(upwash=lambda time: 2.0)
    assert flown_with(FIGHTER, STILL, 0.0, level).alpha[0] == pytest.approx(2.0 / FIGHTER.airspeed)
    assert float(np.min(flight.alpha)) < np.radians(-0.5)


def test_a_gyro_settles_and_a_vane_reads_the_elevator() -> None:
    still = flown_with(TRAINER, SHORT, 0.02, Term())
    warmed = flown_with(TRAINER, SHORT, 0.02, term_of(sensors.gyro_warms, 6.0, TRAINER))
    np.testing.assert_allclose(
        warmed.q - still.q, 6.0 * USUAL["q"] * -np.expm1(-still.time / 5.0), atol=1e-15
    )
    felt = flown_with(TRAINER, SHORT, 0.02, term_of(sensors.vane_feels_elevator, 0.2, TRAINER))
    np.testing.assert_allclose(felt.alpha - still.alpha, 0.2 * still.elevator, atol=1e-15)


@pytest.mark.parametrize("asked", [0.4, 1.8, 4.0])
def test_a_vane_on_a_spring_answers_as_an_oscillator(asked: float) -> None:
    natural, damping = 1.8, 0.08
    time = np.arange(0.0, 30.0, STEP)
    shown = sensors.swinging(natural, flight_of(0.01 * np.sin(2.0 * np.pi * asked * time))).alpha
    ratio = asked / natural
    # Straight lines between grid points: (omega h)^2/12 of the motion, 0.1 % at 4 Hz.
    expected = 0.01 / np.hypot(1.0 - ratio**2, 2.0 * damping * ratio)
    assert 0.5 * np.ptp(shown[time > 15.0]) == pytest.approx(expected, rel=0.01)


def test_a_hum_wanders_between_its_two_frequencies() -> None:
    term = term_of(sensors.wandering_hum, 3.0, TRAINER)
    shown = term.read(flight_of(np.zeros(round(34.0 / STEP)))).q / USUAL["q"]
    assert float(np.max(shown)) == pytest.approx(3.0, rel=1e-3)
    crossings = np.flatnonzero(np.diff(np.sign(shown)) != 0) * STEP
    pace = 0.5 / np.diff(crossings)  # Hz, of half a period each
    assert 1.9 < float(np.min(pace)) < 2.2 and 5.5 < float(np.max(pace)) < 6.7
    assert len(crossings) / 2.0 / 34.0 == pytest.approx(4.0, abs=0.1), (
        "two whole wanderings: the middle on average"
    )
    other = sensors.wandering_hum(3.0, TRAINER, 34.0, np.random.default_rng(FRESH + 1))
    assert not np.array_equal(
        shown, other.read(flight_of(np.zeros(round(34.0 / STEP)))).q / USUAL["q"]
    )
