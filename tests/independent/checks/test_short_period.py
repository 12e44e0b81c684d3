"""The second simulator against closed forms: the linear short period, the phugoid, its actuators,
and the derivatives without alpha_dot.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigvals
from scipy.signal import lsim

from tests.independent.flight import G0, Vehicle
from tests.independent.maneuvers import Maneuver, Pulse, doublet, tick_for, training, validation
from tests.independent.short_period import (
    FIGHTER,
    STEP,
    TRAINER,
    VEHICLES,
    Hidden,
    first_order,
    flown,
    rates,
    second_order,
)

SHORT = Maneuver(doublet(0.5, 0.6), 6.0)


def matrices(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    d, a, b, k = vehicle.derivatives, vehicle.lift_slope, vehicle.moment_slope, vehicle.rate_time
    return (
        np.array(
            [[-a * d["CL_alpha"], 1.0 - a * k * d["CL_q"]], [b * d["Cm_alpha"], b * k * d["Cm_q"]]]
        ),
        np.array([[-a * d["CL_de"]], [b * d["Cm_de"]]]),
    )


@pytest.mark.parametrize("name", VEHICLES)
def test_without_the_phugoid_it_is_the_linear_short_period(name: str) -> None:
    vehicle = VEHICLES[name]
    flight = flown(vehicle, SHORT, 0.02)
    a, b = matrices(vehicle)
    _, _, states = lsim((a, b, np.eye(2), np.zeros((2, 1))), flight.elevator, flight.time)
    # Runge-Kutta at 2.5 ms: (omega h)^4 is 1e-8 of the motion, the ramps between grid points are
    # straight in both.
    np.testing.assert_allclose(np.stack([flight.alpha, flight.q]), states.T, atol=1e-7)
    lift = vehicle.lift_slope * vehicle.airspeed / G0
    d = vehicle.derivatives
    loads = lift * (
        d["CL_alpha"] * flight.alpha
        + d["CL_q"] * flight.q * vehicle.rate_time
        + d["CL_de"] * flight.elevator
    )
    np.testing.assert_allclose(flight.nz - 1.0, loads, atol=1e-12)
    frequency, damping = vehicle.short_period()
    roots = eigvals(a)
    np.testing.assert_allclose(
        [abs(roots[0]), -roots[0].real / abs(roots[0])], [frequency, damping], rtol=1e-9
    )


def test_the_phugoid_swings_near_its_textbook_frequency() -> None:
    """The slow root of the equations linearised by differences: near sqrt(2) g/V (Lanchester),
    lightly damped by drag.
    """
    vehicle = FIGHTER
    start, steps = np.array([0.0, 0.0, 0.0, vehicle.airspeed]), np.array([1e-6, 1e-6, 1e-6, 1e-3])
    hidden = Hidden(exchange=True)
    np.testing.assert_allclose(rates(vehicle, hidden, start, 0.0)[0], 0.0, atol=1e-12)
    columns = [
        (rates(vehicle, hidden, start + d, 0.0)[0] - rates(vehicle, hidden, start - d, 0.0)[0])
        / (2.0 * np.sum(d))
        for d in np.diag(steps)
    ]
    roots = eigvals(np.stack(columns, axis=1))
    slow = roots[np.argmin(np.abs(roots))]
    assert abs(slow) == pytest.approx(np.sqrt(2.0) * G0 / vehicle.airspeed, rel=0.1)
    assert 0.0 < -slow.real / abs(slow) < 0.2


def test_a_deceleration_takes_lift_with_the_dynamic_pressure() -> None:
    still = Maneuver((Pulse(1.0, 1.0, 0.0),), 4.0)
    flight = flown(TRAINER, still, 0.0, Hidden(deceleration=1.0))
    np.testing.assert_allclose(flight.airspeed, TRAINER.airspeed - flight.time, atol=1e-9)
    # Within the first tenth of a second alpha has not yet followed: the load factor is the pressure
    # alone.
    early = flight.time < 0.1
    np.testing.assert_allclose(
        flight.nz[early], (flight.airspeed[early] / TRAINER.airspeed) ** 2, atol=3e-4
    )
    assert flight.alpha[-1] > 0.0


def test_actuators_against_their_transfer_functions() -> None:
    time = STEP * np.arange(2401)
    command = SHORT.at(time)
    _, exact, _ = lsim(([100.0], [1.0, 12.0, 100.0]), command, time)
    np.testing.assert_allclose(second_order(10.0, 0.6)(command), exact, atol=1e-9)
    _, exact, _ = lsim(([1.0], [0.1, 1.0]), command, time)
    np.testing.assert_allclose(first_order(0.1)(command), exact, atol=1e-9)
    late = flown(TRAINER, SHORT, 0.02, Hidden(surface=first_order(0.1)))
    assert np.array_equal(late.elevator, flown(TRAINER, SHORT, 0.02).elevator), (
        "the record holds the command"
    )


def test_an_unequal_control_works_more_to_one_side() -> None:
    one = Maneuver((Pulse(0.5, 0.5, 1.0),), 1.5)
    equal, unequal = (flown(TRAINER, one, 0.01, Hidden(unequal=k)) for k in (0.0, 0.3))
    down, up = (flown(TRAINER, one, size, Hidden(unequal=0.3)) for size in (0.01, -0.01))
    np.testing.assert_allclose(unequal.q, 1.3 * equal.q, atol=1e-12)
    np.testing.assert_allclose(down.q, -1.3 / 0.7 * up.q, atol=1e-12)


def test_derivatives_without_alpha_dot_give_the_same_motion_as_with_it() -> None:
    """The printed numbers of the trainer, alpha_dot kept and solved for, have the eigenvalues of
    the lumped model.
    """
    v = TRAINER
    cl_a, cl_ad, cl_q, cm_a, cm_ad, cm_q = 4.41, 1.7, 3.9, -0.613, -7.27, -12.4
    a, b, k = v.lift_slope, v.moment_slope, v.rate_time
    left = np.array([[1.0 + a * k * cl_ad, 0.0], [-b * k * cm_ad, 1.0]])
    right = np.array([[-a * cl_a, 1.0 - a * k * cl_q], [b * cm_a, b * k * cm_q]])
    np.testing.assert_allclose(
        np.sort_complex(eigvals(np.linalg.solve(left, right))),
        np.sort_complex(eigvals(matrices(v)[0])),
        rtol=1e-9,
    )


def test_maneuvers_begin_at_rest_and_switch_on_tenths() -> None:
    time = np.arange(0.0, 25.0, 0.0025)
    for tick in (0.3, 0.6, 1.0):
        for maneuver in (*training(tick), validation(tick)):
            command = maneuver.at(time)
            assert np.all(command[time < 1.4] == 0.0) and np.max(np.abs(command)) == pytest.approx(
                max(abs(p.size) for p in maneuver.pulses)
            )
            assert command[-1] == pytest.approx(0.0, abs=1e-12)
            for pulse in maneuver.pulses:
                assert (
                    10.0 * pulse.start == pytest.approx(round(10.0 * pulse.start))
                    and pulse.start + pulse.width < maneuver.duration - 2.0
                )
    assert (
        tick_for(3.0) == pytest.approx(0.5)
        and tick_for(0.1) == pytest.approx(1.0)
        and tick_for(30.0) == pytest.approx(0.3)
    )
