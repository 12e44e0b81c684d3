"""Records without a bank angle: level wings are said, and nothing is told where the rates of roll
and yaw speak against them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.check import bank_angle_warnings, compatibility
from ident.compatibility.six_degrees.kinematics import WINGS_LEVEL_NOTE
from ident.compatibility.trials import CompatibilitySettings
from sim.maths import G0
from sim.record import Channel, Record
from tests.unit.ident.compatibility.flights import FOUR, SPEED, record

AT_SPEED = CompatibilitySettings(airspeed=SPEED)
GYRO = np.radians(0.15)


def turning(
    roll: float = 0.0,
    seconds: float = 3.0,
    bias: float = 0.0,
    channels: tuple[str, ...] = ("p", "r"),
) -> Record:
    """A longitudinal record beside the gyros of an aircraft that banks to ``roll`` (rad) and back
    in so many seconds each, turning as it banks.
    """
    one, rng = record(FOUR, seed=1), np.random.default_rng(2)
    t = one.time
    phi = roll * 0.5 * (1.0 - np.cos(2.0 * np.pi * np.clip((t - 5.0) / (2.0 * seconds), 0.0, 1.0)))
    rates = {"p": np.gradient(phi, t) + bias, "r": G0 / SPEED * np.tan(phi)}
    extra = tuple(
        Channel.of(name, "rad/s", rates[name] + GYRO * rng.standard_normal(len(t)))
        for name in channels
    )
    return replace(one, outputs=(*one.outputs, *extra))


@pytest.mark.long
@pytest.mark.parametrize("channels", [(), ("p",), ("r",), ("p", "r")])
def test_level_flight_is_taken_as_level_and_that_is_said(channels: tuple[str, ...]) -> None:
    found = compatibility([turning(channels=channels)], AT_SPEED)
    assert found.notes.count(WINGS_LEVEL_NOTE) == 1 and set(found.relations) == {"alpha", "theta"}


def test_a_gyro_with_a_bias_is_no_bank() -> None:
    assert bank_angle_warnings([turning(bias=np.radians(1.0))], SPEED, G0) == ()


@pytest.mark.parametrize("channels", [("p",), ("r",), ("p", "r")])
def test_of_banked_flight_nothing_is_told(channels: tuple[str, ...]) -> None:
    found = compatibility([turning(), turning(np.radians(40.0), channels=channels)], AT_SPEED)
    assert (
        not found.relations
        and not found.findings
        and WINGS_LEVEL_NOTE not in found.notes
        and len(found.single) == 2
    )
    (line,) = found.unobservable
    assert f"{' and '.join(channels)} show" in line
    lean = float(line.split("up to ")[1].split(" deg")[0])
    assert lean == pytest.approx(40.0, abs=6.0 if "p" in channels else 10.0)


def test_what_a_bank_leaves_in_the_relation_of_theta_is_what_the_limit_is_about() -> None:
    """Pitch attitude by Euler's equation against that of level wings: the fewest degrees of bank
    that mislead are those that are refused.
    """
    for roll, refused in ((4.0, False), (40.0, True)):
        given = turning(np.radians(roll))
        t, p, r, q = given.time, given["p"].values, given["r"].values, given["q"].values
        phi = np.concatenate([[0.0], np.cumsum(0.5 * (p[1:] + p[:-1]) * np.diff(t))])
        off = np.cumsum((q * np.cos(phi) - r * np.sin(phi) - q) * np.median(np.diff(t)))
        left = off - np.polyval(np.polyfit(t, off, 1), t)
        assert (
            (float(np.std(left)) > 0.002)
            is refused
            is bool(bank_angle_warnings([given], SPEED, G0))
        )


def test_a_recorded_bank_serves_and_is_not_asked_for() -> None:
    banked = turning(np.radians(40.0))
    phi = Channel.of("phi", "rad", np.radians(40.0) * np.ones(len(banked)))
    assert bank_angle_warnings([replace(banked, outputs=(*banked.outputs, phi))], SPEED, G0) == ()
