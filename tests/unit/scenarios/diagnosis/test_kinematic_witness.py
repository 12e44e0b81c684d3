"""The kinematics as a witness: asked once, and only of what they know."""

from __future__ import annotations

import pytest

from ident.tracing.diagnosis import Quantity
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.diagnosis.witness import KinematicWitness
from tests.unit.scenarios.diagnosis.test_kinematics import checked, estimate, finding

DELAY = {"delay": Quantity(0.061, 0.002, "s")}


@pytest.mark.parametrize(
    ("kinematics", "worth"),
    [
        (checked([finding("sensor-delay:alpha", 0.058, 0.004)]), 1),
        (checked([finding("sensor-delay:alpha", 0.090, 0.004)]), 1),  # another value: the fault is there all the same
        (checked([], [estimate(0.001, 0.005)]), -1),
        (checked([], [estimate(0.030, 0.020)]), 0),
        (Kinematics((), None, "no record measures alpha, q, nz together"), 0),
    ],
)
def test_for_against_or_silent(kinematics: Kinematics, worth: int) -> None:
    assert KinematicWitness(lambda: kinematics)("sensor-delay:alpha", DELAY) == worth


def test_one_check_at_most_and_none_unasked() -> None:
    made: list[int] = []

    def check() -> Kinematics:
        made.append(1)
        return checked([finding("sensor-delay:alpha", 0.058, 0.004)])

    witness = KinematicWitness(check)
    assert made == []
    assert [witness("sensor-delay:alpha", DELAY), witness("input-delay", DELAY), witness("sensor-delay:q", DELAY)] == [1, 0, 0]
    assert witness.kinematics is witness.kinematics and made == [1]
    assert KinematicWitness(None)("sensor-delay:alpha", DELAY) == 0 and KinematicWitness(None).kinematics is None
