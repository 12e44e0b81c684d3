"""Where a flight by JSBSim is refused as gone astray, and the pilot's units; without JSBSim."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenarios.trials.jsbsim_machine import INERTIA, POUND, READ, SLUG, Condition, _refuse_departure
from sim.errors import DeclarationError

CONDITION = Condition("A320", 6000.0, 200.0, 0.0025)


def astray(phi: float, theta: float) -> bool:
    """Whether a flight is refused that reaches these angles (deg) once."""
    signals = {
        name: np.radians([0.0, value, 0.0]) for name, value in (("phi", phi), ("theta", theta))
    }
    try:
        _refuse_departure(CONDITION, signals)
    except DeclarationError as error:
        assert str(error).startswith("key size: A320 departs from controlled flight")
        return True
    return False


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_flight_goes_astray_beyond_75_degrees_of_bank_and_60_of_pitch(sign: float) -> None:
    """Short of the vertical, where Euler angles are singular."""
    assert not astray(sign * 74.9, 0.0) and astray(sign * 75.1, 0.0)
    assert not astray(0.0, sign * 59.9) and astray(0.0, sign * 60.1)
    assert not astray(sign * 74.9, sign * 59.9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_flight_whose_numbers_end_goes_astray(bad: float) -> None:
    with pytest.raises(DeclarationError, match="departs from controlled flight"):
        _refuse_departure(
            CONDITION, {"phi": np.zeros(3), "theta": np.zeros(3), "q": np.array([0.0, bad, 0.0])}
        )


def test_units_are_those_of_the_international_foot_and_pound() -> None:
    """0.3048 m and 0.45359237 kg exactly; a slug is a pound force per foot per second squared."""
    pound_force = 0.45359237 * 9.80665
    assert pytest.approx(pound_force, rel=1e-12) == POUND
    assert pytest.approx(pound_force / 0.3048, rel=1e-12) == SLUG
    assert pytest.approx(pound_force * 0.3048, rel=1e-12) == INERTIA
    factor = {name: scale for name, (_, scale) in READ.items()}
    assert factor["moment_m"] == pytest.approx(pound_force * 0.3048) and factor[
        "force_z"
    ] == pytest.approx(pound_force)
    assert factor["air_density"] * 0.0023769 == pytest.approx(1.225, rel=1e-4), (
        "sea level, standard atmosphere"
    )
