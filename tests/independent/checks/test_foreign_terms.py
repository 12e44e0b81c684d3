"""The causes outside the library against closed forms, linear equations written out, and their own
definitions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim, welch

from tests.independent.flight import G0, Vehicle
from tests.independent.foreign import controls, loads, masses, surroundings
from tests.independent.foreign.simulator import STEP, Make, Now, Term, along, flown_with
from tests.independent.maneuvers import Maneuver, Pulse, doublet
from tests.independent.short_period import FIGHTER, TRAINER, VEHICLES, Hidden, flown

SHORT = Maneuver(doublet(0.5, 0.6), 6.0)
STILL = Maneuver((Pulse(0.5, 0.5, 0.0),), 6.0)
TINY = 1e-4  # rad of elevator, at which products of two motions are a thousandth of one
FRESH = 5  # seed of what is drawn


def term_of(make: Make, size: float, vehicle: Vehicle, duration: float = SHORT.duration) -> Term:
    return make(size, vehicle, duration, np.random.default_rng(FRESH))


def now_of(
    vehicle: Vehicle, own: tuple[float, ...] = (), time: float = 0.0, **motion: float
) -> Now:
    still = Now(vehicle, time, 0.0, 0.0, 0.0, vehicle.airspeed, 0.0, np.array(own))
    return replace(still, **motion)  # type: ignore[arg-type]


def rows(v: Vehicle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rates of alpha and q, and the load factor from trim, each over (alpha, q, elevator, CL added,
    Cm added).
    """
    d, a, b, k = v.derivatives, v.lift_slope, v.moment_slope, v.rate_time
    alpha_rate = np.array([-a * d["CL_alpha"], 1.0 - a * k * d["CL_q"], -a * d["CL_de"], -a, 0.0])
    q_rate = b * np.array([d["Cm_alpha"], k * d["Cm_q"], d["Cm_de"], 0.0, 1.0])
    load = a * v.airspeed / G0 * np.array([d["CL_alpha"], k * d["CL_q"], d["CL_de"], 1.0, 0.0])
    return alpha_rate, q_rate, load


def linear_motion(
    v: Vehicle, made: np.ndarray, own: np.ndarray, flight_time: np.ndarray, command: np.ndarray
) -> np.ndarray:
    """alpha and q, rows of an array, of short period and own states z.

    ``made`` tells (elevator, CL, Cm) and ``own`` the rates of z, each over (alpha, q, z, command).
    """
    count = len(own)
    basis = np.zeros((5, 3 + count))
    basis[0, 0] = basis[1, 1] = 1.0
    basis[2:] = made
    body = np.stack([row @ basis for row in rows(v)[:2]])
    whole = np.vstack([body, own])
    _, _, states = lsim(
        (whole[:, :-1], whole[:, -1:], np.eye(2 + count), np.zeros((2 + count, 1))),
        command,
        flight_time,
    )
    return np.asarray(states.T[:2])


def linear_of(name: str, size: float, v: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """``made`` and ``own`` of a cause, written out a second time; columns alpha, q, own states,
    command.
    """
    d = v.derivatives
    if name == "wagner":
        share, pace = (
            (0.165, 0.335),
            [2.0 * v.airspeed / (v.chord * size) * b for b in (0.0455, 0.3)],
        )
        lift = d["CL_alpha"] * np.array([-sum(share), 0.0, *share, 0.0])
        return np.array([[0.0, 0.0, 0.0, 0.0, 1.0], lift, np.zeros(5)]), np.array(
            [[pace[0], 0, -pace[0], 0, 0], [pace[1], 0, 0, -pace[1], 0]]
        )
    if name == "memory":
        moment = size * d["Cm_alpha"] * np.array([1.0, 0.0, -1.0, 0.0])
        slow = v.short_period()[0] / 2.0
        return np.array([[0.0, 0.0, 0.0, 1.0], -moment / 2.5, moment]), np.array(
            [[slow, 0.0, -slow, 0.0]]
        )
    if name == "creep":
        return np.array([[0.0, 0.0, -1.0, 1.0], np.zeros(4), np.zeros(4)]), np.array(
            [[0.0, 0.0, -1.0 / 1.2, size / 1.2]]
        )
    if name == "bobweight":
        per_lift = v.lift_slope * v.airspeed / G0
        per_g = size * d["Cm_alpha"] / d["Cm_de"] / (per_lift * d["CL_alpha"])
        load = per_lift * np.array([d["CL_alpha"], v.rate_time * d["CL_q"], d["CL_de"], d["CL_de"]])
        return np.array([[0.0, 0.0, 1.0, 1.0], np.zeros(4), np.zeros(4)]), np.array(
            [per_g * load - np.array([0.0, 0.0, 1.0, 0.0])]
        ) / 0.3
    assert name == "slosh"
    rigid = v.moment_slope * np.array(
        [d["Cm_alpha"], v.rate_time * d["Cm_q"], 0.0, 0.0, d["Cm_de"]]
    )
    swing = np.array([2.2**2, 0.0, -(2.2**2), -2.0 * 0.03 * 2.2, 0.0]) - rigid
    moment = np.array([0.0, 0.0, size * abs(d["Cm_alpha"]), 0.0, 0.0])
    return np.array([[0.0, 0.0, 0.0, 0.0, 1.0], np.zeros(5), moment]), np.array(
        [[0.0, 0.0, 0.0, 1.0, 0.0], swing]
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", VEHICLES)
def test_with_nothing_added_it_is_the_second_simulator(name: str) -> None:
    for hidden in (Hidden(), Hidden(exchange=True, climb=0.0)):
        ours, other = (
            flown_with(VEHICLES[name], SHORT, 0.02, Term(), hidden),
            flown(VEHICLES[name], SHORT, 0.02, hidden),
        )
        for channel in ("alpha", "q", "nz", "theta"):
            # Ramps bend within a step of 2.5 ms, which the other simulator joins by straight lines:
            # 1e-5 of an input of 0.02 rad.
            np.testing.assert_allclose(ours.signal(channel), other.signal(channel)[::2], atol=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "make", "size"),
    [
        ("wagner", loads.wagner_lag, 10.0),
        ("memory", loads.wake_memory, 0.7),
        ("creep", controls.cable_creep, 0.35),
        ("bobweight", controls.bobweight, 0.5),
        ("slosh", masses.fuel_slosh, 0.05),
    ],
)
@pytest.mark.parametrize("vehicle", [TRAINER, FIGHTER], ids=lambda one: one.name)
def test_linear_causes_against_their_matrices(
    name: str, make: Make, size: float, vehicle: Vehicle
) -> None:
    flight = flown_with(vehicle, SHORT, TINY, term_of(make, size, vehicle))
    rigid = flown_with(vehicle, SHORT, TINY, Term())
    expected = linear_motion(vehicle, *linear_of(name, size, vehicle), flight.time, flight.elevator)
    found, without = np.stack([flight.alpha, flight.q]), np.stack([rigid.alpha, rigid.q])
    scale = np.max(np.abs(without), axis=1)
    # A thousandth: products of motions at this size, and ramps that bend within a step.
    assert np.all(np.max(np.abs(found - expected), axis=1) < 1e-3 * scale)
    assert np.all(np.max(np.abs(found - without), axis=1) > 2e-2 * scale), (
        "the cause does something"
    )


def test_an_automatic_trim_adds_up_what_the_elevator_does() -> None:
    def surface(command: np.ndarray) -> np.ndarray:
        beyond = np.sign(command) * np.maximum(np.abs(command) - np.radians(0.2), 0.0)
        return (
            command
            + 0.15 * np.concatenate([[0.0], np.cumsum(0.5 * (beyond[1:] + beyond[:-1]))]) / 400.0
        )

    one = Maneuver((Pulse(0.5, 1.0, 1.0),), 5.0)
    ours = flown_with(TRAINER, one, 0.02, term_of(controls.auto_trim, 0.15, TRAINER))
    other = flown(TRAINER, one, 0.02, Hidden(surface=surface))
    np.testing.assert_allclose(ours.q, other.q[::2], atol=2e-5)
    assert abs(ours.alpha[-1]) > 0.05 * float(np.max(np.abs(ours.alpha))), (
        "the stabiliser stays where it was driven"
    )


def test_products_of_motions_are_what_they_are_called() -> None:
    d, degrees = TRAINER.derivatives, np.radians
    damping = term_of(loads.quadratic_damping, 2.0, TRAINER)
    for q in (degrees(5.0), degrees(-5.0)):
        # At 5 deg/s the quadratic part is twice the linear one.
        assert damping.loads(now_of(TRAINER, q=q))[1] == pytest.approx(
            2.0 * d["Cm_q"] * TRAINER.rate_time * q
        )
    wake = term_of(loads.control_in_wake, 0.4, TRAINER)
    above, below = (
        wake.loads(now_of(TRAINER, alpha=degrees(4.0) * sign, surface=0.03)) for sign in (1.0, -1.0)
    )
    np.testing.assert_allclose(above, np.array([d["CL_de"], d["Cm_de"]]) * -0.4 * 0.03)
    np.testing.assert_allclose(below, -np.array(above))


def test_hysteresis_depends_on_the_way_and_not_on_the_pace() -> None:
    """Steady rise of alpha from rest: z = BEND (1 - exp(-alpha/BEND)); the same whatever the pace,
    and the other way round back.
    """
    term, bend = term_of(loads.lift_hysteresis, 0.4, TRAINER), np.radians(1.0)
    for pace in (0.05, 0.2):
        steps, z = 4000, np.zeros(1)
        h = np.radians(3.0) / pace / steps
        for _ in range(steps):
            z = z + h * term.rates(now_of(TRAINER, own=(float(z[0]),), alpha_rate=pace))
        assert z[0] == pytest.approx(bend * (1.0 - np.exp(-3.0)), rel=1e-3)
    lift, moment = term.loads(now_of(TRAINER, own=(float(bend),)))
    assert lift == pytest.approx(-0.4 * TRAINER.derivatives["CL_alpha"] * bend) and moment == 0.0


def test_buffet_shakes_in_its_band_above_trim_only() -> None:
    noise = loads.shaking(200.0, np.random.default_rng(FRESH))
    frequency, power = welch(noise, 1.0 / STEP, nperseg=2048)
    assert float(np.std(noise)) == pytest.approx(1.0) and frequency[
        np.argmax(power)
    ] == pytest.approx(4.0, abs=0.7)
    term = term_of(loads.buffet, 0.1, TRAINER, 200.0)
    per_g = TRAINER.lift_slope * TRAINER.airspeed / G0
    felt = [
        per_g * term.loads(now_of(TRAINER, time=t, alpha=np.radians(4.0)))[0]
        for t in np.arange(0.0, 200.0, STEP)
    ]
    assert float(np.std(felt)) == pytest.approx(0.1, rel=0.01)
    assert term.loads(now_of(TRAINER, time=3.0, alpha=-0.05)) == (0.0, 0.0)


def test_values_between_grid_points_lie_on_straight_lines() -> None:
    at = along(np.array([0.0, 2.0, -2.0]), 0.5)
    assert [at(t) for t in (-1.0, 0.25, 0.5, 0.75, 1.0, 9.0)] == [0.0, 1.0, 2.0, 0.0, -2.0, -2.0]


def test_ground_effect_is_trimmed_at_the_start_and_gone_far_above() -> None:
    term, d = term_of(surroundings.ground_effect, 0.5, FIGHTER), FIGHTER.derivatives
    trim = 1.0 / (FIGHTER.lift_slope * FIGHTER.airspeed / G0)
    assert term.loads(now_of(FIGHTER, own=(0.0,))) == (0.0, 0.0)
    near = term.loads(now_of(FIGHTER, own=(0.0,), alpha=0.01))
    np.testing.assert_allclose(near, [0.5 * d["CL_alpha"] * 0.01, 0.5 * d["Cm_alpha"] * 0.01])
    np.testing.assert_allclose(
        term.loads(now_of(FIGHTER, own=(1e9,), alpha=0.01)), [-0.1 * trim, 0.01]
    )
    assert term.rates(now_of(FIGHTER, own=(0.0,), theta=0.05, alpha=0.03))[0] == pytest.approx(
        FIGHTER.airspeed * np.sin(0.02)
    )
