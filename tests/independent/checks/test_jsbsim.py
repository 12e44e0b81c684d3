"""JSBSim's flights: trimmed, level, with the surface and the signs that the record promises."""

from __future__ import annotations

import numpy as np
import pytest

from tests.independent.fly import STRAIGHT, rehearsed, severity_at
from tests.independent.jsbsim_aircraft import AIRCRAFT
from tests.independent.jsbsim_flight import AVAILABLE, FINE, RoughAir, bend_of, fly, vehicle_of
from tests.independent.maneuvers import Maneuver, doublet, training

pytestmark = pytest.mark.skipif(
    not AVAILABLE, reason="JSBSim is not installed (pip install 'flightid[jsbsim]')"
)
NAME = "T38"


def test_signs_derivatives_and_kinematics_of_one_aircraft() -> None:
    aircraft = AIRCRAFT[NAME]
    motion = fly(aircraft, aircraft.conditions[0], Maneuver(doublet(1.0, 0.8), 8.0), 0.02)
    flight = motion.flight
    begin = slice(0, round(0.9 * FINE))
    for name in ("alpha", "q", "nz", "elevator"):
        assert np.ptp(flight.signal(name)[begin]) < 1e-4, f"{name} is not at rest"
    assert flight.nz[0] == pytest.approx(1.0, abs=0.015), (
        "a round rotating Earth takes a part in a hundred at most"
    )
    vehicle, lost = vehicle_of(motion, NAME)
    assert lost < 1e-4
    d = vehicle.derivatives
    assert (
        d["Cm_de"] < 0.0 < d["CL_alpha"]
        and d["Cm_alpha"] < 0.0
        and d["Cm_q"] < 0.0
        and d["CL_de"] > 0.0
    )
    # Kinematics that no model enters: alpha_dot = q - (g/V)(nz - cos of the path), to the sideways
    # parts and the cosine of alpha.
    expected = flight.q - 9.80665 / flight.airspeed * (flight.nz - flight.nz[0])
    assert np.std(flight.rate_of("alpha") - expected) < 0.02 * np.std(flight.q)
    # q is the integral of the moment without a delay: half a fine step would already be 1.25 ms.
    acceleration = motion.moment / motion.pitch_inertia
    late = np.linalg.lstsq(
        np.stack([acceleration, np.gradient(acceleration, flight.step)], axis=1),
        flight.rate_of("q"),
        rcond=None,
    )[0]
    assert abs(late[1] / late[0]) < 2e-4
    again = fly(aircraft, aircraft.conditions[0], Maneuver(doublet(1.0, 0.8), 8.0), 0.02).flight
    np.testing.assert_array_equal(again.alpha, flight.alpha)


def test_rough_air_shakes_and_is_the_same_for_the_same_seed() -> None:
    aircraft = AIRCRAFT[NAME]
    still = Maneuver(doublet(1.0, 0.8), 4.0)
    first, again, other = (
        fly(aircraft, aircraft.conditions[0], still, 0.0, RoughAir(3, seed)).flight
        for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first.alpha, again.alpha)
    assert not np.array_equal(first.alpha, other.alpha)
    assert 0.001 < np.std(first.nz) < 0.2
    assert severity_at(30000.0) > severity_at(15000.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", AIRCRAFT)
def test_each_aircraft_flies_nearly_straight_tables_in_both_conditions(name: str) -> None:
    aircraft = AIRCRAFT[name]
    for condition in aircraft.conditions:
        ready = rehearsed(aircraft, condition)
        assert ready.bend < 1.5 * STRAIGHT
        assert ready.vehicle.short_period()[0] > 0.3
        motion = fly(aircraft, condition, training(0.5)[0], ready.size)
        assert max(bend_of(motion, ready.vehicle)) < 0.01
        assert (
            np.max(np.abs(motion.flight.airspeed - motion.flight.trim_airspeed))
            < 0.1 * motion.flight.trim_airspeed
        )
