"""The kinematics as a witness: asked once, and only of what they know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.faults import DELAY, SensorFault
from ident.compatibility.fitting import Fit, fit
from ident.compatibility.result import CompatibilitySettings
from ident.compatibility.signals import signals_of
from ident.tracing.diagnosis import Quantity
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.diagnosis.witness import KinematicWitness, kinematic_contradiction, kinematic_evidence, shares_a_twin, twin_of
from sim.record import Record
from tests.oracles.flight_path import Sensors
from tests.unit.ident.compatibility.flights import SPEED, THREE, record
from tests.unit.scenarios.diagnosis.test_kinematics import checked, estimate, finding

DELAYED = {"delay": Quantity(0.061, 0.002, "s")}


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
    assert KinematicWitness(lambda: kinematics)("sensor-delay:alpha", DELAYED) == worth


def test_one_check_at_most_and_none_unasked() -> None:
    made: list[int] = []

    def check() -> Kinematics:
        made.append(1)
        return checked([finding("sensor-delay:alpha", 0.058, 0.004)])

    witness = KinematicWitness(check)
    assert made == []
    assert [witness("sensor-delay:alpha", DELAYED), witness("input-delay", DELAYED), witness("sensor-delay:q", DELAYED)] == [1, 0, 0]
    assert witness.kinematics is witness.kinematics and made == [1]
    assert KinematicWitness(None)("sensor-delay:alpha", DELAYED) == 0 and KinematicWitness(None).kinematics is None


ARMS_FOUND = (("vane-offset", 6.0), ("accelerometer-offset:nz", -6.0))
SCALE, ARM = {"scale": Quantity(1.1, 0.01, "1")}, {"arm": Quantity(6.0, 0.3, "m")}


@pytest.mark.parametrize(
    ("name", "parameters", "kind", "value"),
    [
        ("sensor-scale:alpha", SCALE, "scale", 1.1),
        ("sensor-scale:q", SCALE, "scale", 1.1),
        ("sensor-scale:nz", SCALE, "scale", 1.1),
        ("vane-offset", ARM, "arm", 6.0),
        ("accelerometer-offset:nz", ARM, "arm", 6.0),
    ],
)
def test_of_what_is_another_effect_word_for_word_it_says_nothing(name: str, parameters: dict[str, Quantity], kind: str, value: float) -> None:
    witness = KinematicWitness(lambda: checked([finding(name, value, 0.01, kind=kind)], [replace(estimate(value, 0.01, kind=kind), name=name)]))
    assert witness(name, parameters) == 0 and witness.evidence(name, parameters) == 0.0


def test_an_arm_of_another_size_is_spoken_against_under_either_name() -> None:
    ahead, behind = {"arm": Quantity(6.0, 0.3, "m")}, {"arm": Quantity(-6.0, 0.3, "m")}
    vane, accelerometer = (checked([replace(finding(name, value, 0.5, kind="arm"), gain=40.0)]) for name, value in ARMS_FOUND)
    for found in (vane, accelerometer):
        witness = KinematicWitness(lambda found=found: found)  # type: ignore[misc]
        assert witness.against("vane-offset", ahead) == 0.0 and witness.against("accelerometer-offset:nz", behind) == 0.0
        assert witness.against("vane-offset", behind) > 50.0 and witness.against("accelerometer-offset:nz", ahead) > 50.0
        assert witness.evidence("vane-offset", behind) == 0.0
    assert KinematicWitness(None).against("vane-offset", behind) == 0.0
    assert KinematicWitness(lambda: checked([])).against("vane-offset", behind) == 0.0


def _felt(arm: float) -> Record:
    """An accelerometer ``arm`` m ahead of the centre of gravity: nz + (arm/g) times the pitch acceleration, by differences."""
    true = record(noise=0.0)
    felt = true["nz"].values + arm / 9.80665 * np.gradient(true["q"].values, true.time)
    noisy = record(seed=1)
    values = {"nz": felt + noisy["nz"].values - true["nz"].values}
    return replace(noisy, outputs=tuple(replace(each, values=values.get(each.name, each.values)) for each in noisy.outputs))


@pytest.mark.parametrize(
    ("flown", "ahead"), [(record(sensors=Sensors(arm=15.0), seed=1), -15.0), (_felt(15.0), 15.0)], ids=["vane ahead", "accelerometer ahead"]
)
def test_the_arm_of_an_accelerometer_is_that_of_a_vane_on_the_other_side(flown: Record, ahead: float) -> None:
    """The oracle of the sign: each flown by itself, and what stands there for the accelerometer."""
    found = compatibility([flown], CompatibilitySettings(SPEED))
    (own,) = [each for each in found.findings if each.name == "accelerometer-offset:nz"]
    assert own.stands and abs(own.value - ahead) < 3.0 * own.std
    kinematics = Kinematics(("record",), found)
    for name, arm in (("accelerometer-offset:nz", ahead), ("vane-offset", -ahead)):
        assert kinematic_contradiction(kinematics, name, {"arm": Quantity(arm, 0.5, "m")}) == 0.0
        assert kinematic_contradiction(kinematics, name, {"arm": Quantity(-arm, 0.5, "m")}) > 50.0


def test_against_a_fault_without_twin_is_the_evidence_turned_round() -> None:
    kinematics = checked([replace(finding("sensor-delay:alpha", 0.2, 0.004), gain=30.0)], [estimate(0.2, 0.004)])
    said = kinematic_evidence(kinematics, "sensor-delay:alpha", DELAYED)
    assert said < -30.0 and kinematic_contradiction(kinematics, "sensor-delay:alpha", DELAYED) == -said


def test_a_group_with_such_a_member_is_as_silent() -> None:
    alone = checked([finding("sensor-lag:q", 0.02, 0.002, kind="lag")])
    among = checked([finding("sensor-lag:q", 0.02, 0.002, ("accelerometer-offset:nz",), kind="lag")])
    late = {"time_constant": Quantity(0.02, 0.002, "s")}
    assert KinematicWitness(lambda: alone)("sensor-lag:q", late) == 1 and KinematicWitness(lambda: among)("sensor-lag:q", late) == 0


def test_theta_and_airspeed_tell_some_twins_apart() -> None:
    assert twin_of("sensor-scale:alpha", THREE) == "time-base" and twin_of("sensor-scale:alpha", (*THREE, "theta")) == ""
    assert twin_of("sensor-scale:q", (*THREE, "airspeed")) == "" and twin_of("sensor-scale:nz", (*THREE, "airspeed")) == "sensor-coupling:q"
    assert twin_of("vane-offset", (*THREE, "theta", "airspeed", "ax")) == "accelerometer-offset:nz" and twin_of("sensor-delay:alpha", THREE) == ""


def test_a_clock_that_runs_slow_is_a_scale_of_alpha_to_the_kinematics() -> None:
    """The oracle of the twin: the record's time stretched, and what stands is alpha read too small by as much."""
    true = record(seed=1, noise=0.5)
    slow = replace(true, time=1.1 * true.time)
    found = compatibility([slow], CompatibilitySettings(SPEED))
    (scale,) = [each for each in found.findings if each.name == "sensor-scale:alpha"]
    assert scale.stands and abs(scale.value - 1.0 / 1.1) < 3.0 * scale.std and shares_a_twin("sensor-scale:alpha", found)


def _cost_at(delay: float) -> tuple[Fit, float]:
    """The likelihood with alpha late by a given time, computed another way: the record itself moved back, and no fault fitted."""
    late = record(sensors=Sensors(delay={"alpha": 0.06}), seed=1)
    moved = np.interp(late.time + delay, late.time, late["alpha"].values)
    s = signals_of(replace(late, outputs=(replace(late["alpha"], values=moved), *late.outputs[1:])), THREE, SPEED, 9.80665)
    found = fit([s])
    return found, found.cost


def test_evidence_is_the_log_likelihood_at_the_claimed_value_over_that_of_absence() -> None:
    result = compatibility([record(sensors=Sensors(delay={"alpha": 0.06}), seed=1)], CompatibilitySettings(SPEED))
    kinematics = Kinematics(("record",), result)
    (own,) = [each for each in result.findings if each.name == "sensor-delay:alpha"]

    def says(value: float, std: float = 1e-6) -> float:
        return kinematic_evidence(kinematics, own.name, {"delay": Quantity(value, std, "s")})

    assert says(own.value) == pytest.approx(own.gain, rel=1e-6) and says(own.value) > 100.0
    apart = 2.0 * np.hypot(own.std, 0.5 * SensorFault("alpha", DELAY).worth)
    assert says(own.value) - says(own.value + apart) == pytest.approx(2.0, rel=1e-3)
    assert says(0.0) < says(0.03) < says(0.06) and says(0.03, 0.02) > says(0.03)
    # A whole number of samples moves without interpolation: 0.08 s and none.
    independent = _cost_at(0.0)[1] - _cost_at(0.08)[1]
    assert 0.0 < says(0.08) < says(0.06) and says(0.08) == pytest.approx(independent, rel=0.35)


def test_evidence_of_a_delay_where_a_lag_stands_is_what_it_loses() -> None:
    result = compatibility([record(sensors=Sensors(lag={"alpha": 0.09}), seed=1)], CompatibilitySettings(SPEED))
    kinematics = Kinematics(("record",), result)
    (own,) = [each for each in result.findings if each.name == "sensor-delay:alpha"]
    said = kinematic_evidence(kinematics, own.name, {"delay": Quantity(own.value, own.std, "s")})
    assert not own.stands and own.lost is not None and said == pytest.approx(-own.lost) and said < -10.0
    assert KinematicWitness(lambda: kinematics)(own.name, {"delay": Quantity(own.value, own.std, "s")}) == -1


def test_evidence_is_nothing_of_what_is_not_checked() -> None:
    assert KinematicWitness(None).evidence("sensor-delay:alpha", DELAYED) == 0.0
    assert kinematic_evidence(checked([finding("sensor-delay:q", 0.06, 0.004)]), "input-delay", DELAYED) == 0.0
    untold = checked([replace(finding("sensor-delay:alpha", 0.06, 0.004, stands=False))], [estimate(0.06, 0.09, told=False)])
    assert kinematic_evidence(untold, "sensor-delay:alpha", DELAYED) == 0.0
