"""Sets of faults: what each has to bring, what is within chance of it, pairs, arms against delays,
and the channel to which delays refer.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.fault_sets import largest_chance_loss, penalty_per_fault
from ident.compatibility.kinematics import ARM, DELAY, LAG, SCALE, SensorFault
from ident.compatibility.trials import (
    Compatibility,
    CompatibilitySettings,
    leaves_time_reference,
    reference_sentence,
)
from sim.record import Channel, Record
from tests.oracles import undeclared_flights as flights
from tests.oracles.flight_path import UNITS, Sensors, fly, shown
from tests.oracles.undeclared_flights import TRAINER, Hidden
from tests.unit.ident.compatibility.flights import NOISE, PATTERN, SPEED, THREE, record

ALPHA, Q, NZ = (SensorFault(channel, DELAY) for channel in THREE)


@functools.cache
def flown_at(speed: float) -> Mapping[str, np.ndarray]:
    return fly(speed=speed)


def at_speed(speed: float, sensors: Sensors, seed: int) -> Record:
    """A flight at an airspeed of its own, which is recorded."""
    channels = (*THREE, "airspeed")
    columns = shown(
        flown_at(speed),
        25.0,
        sensors,
        {name: NOISE[name] for name in channels},
        np.random.default_rng(seed),
    )
    return Record(
        columns["time"],
        (),
        tuple(Channel.of(name, UNITS[name], columns[name]) for name in channels),
        name=f"{speed:g} m/s",
    )


def controlled(hidden: Hidden, seed: int = 1) -> Record:
    """20 s in still air with the elevator recorded."""
    flown = flights.fly_aircraft(TRAINER, flights.steps(PATTERN, 25.0, 20.0), 25.0, hidden)
    columns = flights.measured(
        flown, np.random.default_rng(seed), {name: NOISE[name] for name in THREE}, hidden
    )
    elevator = Channel.of("elevator", "rad", columns["elevator"])
    return Record(
        columns["time"],
        (elevator,),
        tuple(Channel.of(name, UNITS[name], columns[name]) for name in THREE),
    )


def leaders(found: Compatibility) -> list[str]:
    """The best of each group that stands."""
    out: list[str] = []
    said: set[str] = set()
    for finding in found.findings:
        if finding.supported and finding.name not in said:
            out.append(finding.name)
            said |= {finding.name, *finding.group}
    return out


@pytest.mark.parametrize("distance", [0.5, 2.0, 4.0, 8.0])
def test_the_true_one_of_two_loses_by_more_than_chance_in_no_more_than_its_share(
    distance: float,
) -> None:
    """Two traces ``distance`` standard deviations apart, the first true, and the noise along the
    line between them.
    """
    noise = np.random.default_rng(1).standard_normal(200_000)
    lost = 0.5 * noise**2 - 0.5 * (noise - distance) ** 2
    for share in (0.2, 0.02):
        frequency = float(np.mean(lost > largest_chance_loss(share, 2)))
        assert frequency <= 0.5 * share * 1.1
    # The bound is reached where it is hardest: at a distance of the quantile itself.
    worst = np.sqrt(2.0 * largest_chance_loss(0.02, 2))
    assert float(
        np.mean(noise * worst - 0.5 * worst**2 > largest_chance_loss(0.02, 2))
    ) == pytest.approx(0.01, rel=0.1)


def test_the_best_of_many_absent_faults_brings_the_charge_less_often_than_the_share_of_false_alarms() -> (  # noqa: E501
    None
):
    gains = 0.5 * np.random.default_rng(2).standard_normal((100_000, 14)) ** 2
    for share in (0.1, 0.01):
        assert (
            0.02 * share < float(np.mean(gains.max(axis=1) > penalty_per_fault(share, 14))) < share
        )


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensors", "values"),
    [
        (
            Sensors(lag={"alpha": 0.08}, scale={"alpha": 1.12}),
            {"sensor-lag:alpha": 0.08, "sensor-scale:alpha": 1.12},
        ),
        (
            Sensors(delay={"alpha": 0.06}, scale={"q": 1.1}),
            {"sensor-delay:alpha": 0.06, "sensor-scale:q": 1.1},
        ),
        (
            Sensors(lag={"q": 0.06}, scale={"nz": 0.88}),
            {"sensor-lag:q": 0.06, "sensor-scale:nz": 0.88},
        ),
    ],
)
def test_a_pair_of_faults_is_found_with_both_values(
    sensors: Sensors, values: Mapping[str, float]
) -> None:
    found = compatibility([record(sensors=sensors, seed=1)], CompatibilitySettings(SPEED))
    assert set(leaders(found)) == set(values)
    for finding in found.findings:
        if finding.name in values:
            assert abs(finding.value - values[finding.name]) < 3.0 * finding.std


@pytest.mark.long
def test_a_pair_that_one_other_fault_resembles_is_found_all_the_same() -> None:
    """Alpha late and q too large look much like an arm of the vane; the best single fault is not
    one of the two.
    """
    hidden = Hidden(sensors={"alpha": flights.shown_late(0.06), "q": flights.scaled(1.1)})
    found = compatibility([controlled(hidden)], CompatibilitySettings(TRAINER.airspeed))
    assert set(leaders(found)) == {"sensor-delay:alpha", "sensor-scale:q"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensors", "name"),
    [
        (Sensors(arm=6.0), "vane-offset"),
        pytest.param(Sensors(delay={"alpha": 0.05}), "sensor-delay:alpha", marks=pytest.mark.slow),
    ],
)
def test_several_airspeeds_tell_an_arm_from_a_delay(sensors: Sensors, name: str) -> None:
    found = compatibility(
        [at_speed(v, sensors, i) for i, v in enumerate((90.0, 130.0, 180.0))],
        CompatibilitySettings(),
    )
    assert leaders(found) == [name]
    alike = {finding.name for finding in found.findings if finding.supported}
    assert not {"vane-offset", "sensor-delay:alpha", "sensor-lag:alpha"} - {name} & alike


def test_a_group_holds_what_gains_as_much_within_chance_and_nothing_else() -> None:
    found = compatibility(
        [record(sensors=Sensors(delay={"q": 0.04}), seed=1)], CompatibilitySettings(SPEED)
    )
    chance = largest_chance_loss(0.01, len(found.findings))
    best = found.findings[0]
    for finding in found.findings:
        if finding.supported:
            assert (
                finding.lost is not None
                and finding.lost <= chance
                and best.gain - finding.gain <= chance + 1e-9
            )
        elif finding.name in ("sensor-delay:alpha", "sensor-lag:alpha"):
            assert finding.lost is not None and finding.lost > chance


@pytest.mark.long
def test_three_late_channels_are_two_against_the_one_that_is_least_late() -> None:
    hidden = Hidden(
        sensors={
            "alpha": flights.shown_late(0.10),
            "q": flights.shown_late(0.07),
            "nz": flights.shown_late(0.03),
        }
    )
    found = compatibility([controlled(hidden)], CompatibilitySettings(TRAINER.airspeed))
    late = {
        finding.name: finding
        for finding in found.findings
        if finding.name.startswith("sensor-delay")
    }
    assert (
        set(leaders(found)) <= {"sensor-delay:alpha", "sensor-delay:q", "sensor-lag:q"}
        and len(leaders(found)) == 2
    )
    assert not late["sensor-delay:nz"].supported
    assert late["sensor-delay:alpha"].value == pytest.approx(0.07, abs=0.012) and late[
        "sensor-delay:q"
    ].value == pytest.approx(0.04, abs=0.012)
    assert any(
        note.startswith("delays are relative to nz, the channel with the smallest delay")
        for note in found.notes
    )


def test_not_all_clocks_can_be_late() -> None:
    timed = ("alpha", "q", "nz")
    assert leaves_time_reference((ALPHA, Q), timed) and not leaves_time_reference(
        (ALPHA, Q, NZ), timed
    )
    assert leaves_time_reference((ALPHA, Q, NZ), (*timed, "theta")) and leaves_time_reference(
        (ALPHA, SensorFault("alpha", LAG)), timed
    )
    assert not leaves_time_reference((ALPHA, SensorFault("nz", ARM)), ("alpha", "q"))
    assert "alpha and nz, which agree" in reference_sentence((Q,), timed)
    assert reference_sentence((SensorFault("q", SCALE),), timed) == ""


@pytest.mark.long
def test_without_a_recorded_control_the_load_is_no_clock() -> None:
    found = compatibility(
        [record(sensors=Sensors(delay={"alpha": 0.08, "q": 0.05}), seed=1)],
        CompatibilitySettings(SPEED),
    )
    assert not {"sensor-delay:alpha", "sensor-delay:q"} <= {
        finding.name for finding in found.findings if finding.supported
    }


@pytest.mark.long
def test_an_accelerometer_ahead_is_a_lag_of_q_by_the_arm_over_the_airspeed() -> None:
    """q + T q_dot less (g/V) nz and q less (g/V) (nz - (arm/g) q_dot) are the same for arm = T
    V.
    """
    found = compatibility(
        [controlled(Hidden(accelerometer_arm=2.0))], CompatibilitySettings(TRAINER.airspeed)
    )
    both = {finding.name: finding for finding in found.findings if finding.supported}
    arm, lag = both["accelerometer-offset:nz"], both["sensor-lag:q"]
    assert abs(arm.value - 2.0) < 3.0 * arm.std and arm.value == pytest.approx(
        lag.value * TRAINER.airspeed, rel=0.02
    )
    assert SensorFault("nz", ARM).name == arm.name and not SensorFault("nz", ARM).one_sided


@pytest.mark.long
def test_an_accelerometer_behind_is_an_arm_of_the_vane() -> None:
    found = compatibility(
        [controlled(Hidden(accelerometer_arm=-2.0))], CompatibilitySettings(TRAINER.airspeed)
    )
    both = {finding.name: finding for finding in found.findings if finding.supported}
    assert leaders(found) == ["vane-offset"] and both[
        "accelerometer-offset:nz"
    ].value == pytest.approx(-both["vane-offset"].value, rel=0.01)
