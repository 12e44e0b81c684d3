"""Scatter of the delays that a check finds, and how often it accuses sound sensors; many seeds,
therefore slow.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.trials import CompatibilitySettings
from sim.record import Channel, Record
from tests.oracles import undeclared_flights as flights
from tests.oracles.flight_path import Sensors
from tests.oracles.undeclared_flights import FIGHTER, TRAINER, Hidden
from tests.unit.ident.compatibility.flights import FOUR, NOISE, SPEED, THREE, in_rough_air, record

LATE = 0.06


def linear_flight(hidden: Hidden, seed: int, rate: float = 25.0) -> Record:
    """20 s of a rigid aircraft whose held elevator makes nz jump at samples, with the noise of a
    normal record.
    """
    pattern = flights.three_two_one_one(0.06, 0.5, 1.0) + flights.doublet(-0.03, 1.0, 9.0)
    flown = flights.fly_aircraft(FIGHTER, flights.steps(pattern, rate, 20.0), rate, hidden)
    columns = flights.measured(
        flown, np.random.default_rng(seed), {name: NOISE[name] for name in THREE}, hidden
    )
    units = {"alpha": "rad", "q": "rad/s", "nz": "g"}
    elevator = Channel.of("elevator", "rad", columns["elevator"])
    return Record(
        columns["time"],
        (elevator,),
        tuple(Channel.of(name, units[name], columns[name]) for name in THREE),
    )


@pytest.mark.slow
@pytest.mark.parametrize("channel", THREE)
@pytest.mark.parametrize("kind", ["linear", "body axes"])
def test_a_delay_at_25_hz_is_found_within_5_ms(channel: str, kind: str) -> None:
    errors, sigmas, standing = [], [], 0
    for seed in range(20):
        if kind == "linear":
            one, speed = (
                linear_flight(Hidden(sensors={channel: flights.shown_late(LATE)}), seed),
                FIGHTER.airspeed,
            )
        else:
            one, speed = record(sensors=Sensors(delay={channel: LATE}), seed=seed), SPEED
        found = compatibility([one], CompatibilitySettings(speed))
        (late,) = [
            finding for finding in found.findings if finding.name == f"sensor-delay:{channel}"
        ]
        standing += late.supported
        errors.append(late.value - LATE)
        sigmas.append(late.std)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert standing == 20
    assert rms < 0.005 and 0.6 < rms / float(np.mean(sigmas)) < 1.6
    # The load's share of alpha_dot is small, so that its delay is the least certain: 3 ms of
    # standard deviation.
    assert np.mean(np.abs(errors) < 0.005) >= (0.85 if channel == "nz" else 1.0)


@pytest.mark.slow
def test_sound_sensors_are_accused_in_at_most_one_of_twenty_checks() -> None:
    accused = 0
    for seed in range(100, 160):
        checks = [
            ([record(seed=seed)], SPEED),
            ([record(FOUR, seed=seed)], SPEED),
            ([linear_flight(Hidden(), seed)], FIGHTER.airspeed),
            ([linear_flight(Hidden(), seed, 50.0)], FIGHTER.airspeed),
        ]
        accused += sum(
            any(f.supported for f in compatibility(records, CompatibilitySettings(speed)).findings)
            for records, speed in checks
        )
    assert accused <= 0.05 * 240


@pytest.mark.slow
@pytest.mark.parametrize("turbulence", [0.3, 0.7])
def test_a_delay_in_rough_air_is_found_within_its_standard_deviation(turbulence: float) -> None:
    """The controls tell it from the gust: a plain regression is 9 and 36 ms off here, at 2 and 4
    standard deviations.
    """
    errors, wrong, clean = [], 0, 0
    for seed in range(20):
        found = compatibility(
            [in_rough_air(seed, turbulence, {"alpha": flights.shown_late(LATE)})],
            CompatibilitySettings(TRAINER.airspeed),
        )
        (late,) = [item for item in found.joint.estimates if item.name == "sensor-delay:alpha"]
        errors.append((late.smoother.value - LATE) / late.smoother.std)
        standing = [finding.name for finding in found.findings if finding.supported]
        wrong += bool(standing) and "sensor-delay:alpha" not in standing
        sound = compatibility(
            [in_rough_air(100 + seed, turbulence)], CompatibilitySettings(TRAINER.airspeed)
        )
        clean += any(finding.supported for finding in sound.findings)
    assert (
        0.6 < float(np.sqrt(np.mean(np.square(errors)))) < 1.6 and abs(float(np.mean(errors))) < 1.0
    )
    assert wrong <= 1 and clean <= 1
