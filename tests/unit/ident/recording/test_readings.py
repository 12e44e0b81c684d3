"""Columns that are not what they are called are refused, whichever it is; sound ones, with any
effect of a sensor, are not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.recording.inspection import inspect
from ident.recording.kinematic_relations import (
    ControlPower,
    KinematicColumns,
    _control_power_fit,
    all_readings,
    columns_of,
    control_power,
    disagreement,
    is_reliable,
    unexplained_lift,
)
from ident.recording.series import Certainty, Expectations, Kind, RecordFinding
from sim.record import Channel, Record
from tests.recorded_flight import (
    Aircraft,
    Controller,
    altered,
    controlled,
    drawn,
    exchanged,
    flight,
)

G0, DEGREES = 9.80665, 180.0 / np.pi
CRAFT = Aircraft()


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(21), offsets={"alpha": 0.06, "q": 0.01})


def certain(record: Record, expected: Expectations = CRAFT.expected) -> RecordFinding:
    """The one finding that refuses a record."""
    (one,) = [one for one in inspect(record, expected) if one.certainty is Certainty.CERTAIN]
    return one


@pytest.mark.parametrize("channel", ["alpha", "q", "nz", "elevator"])
def test_a_turned_sign_is_certain_whichever_channel(sound: Record, channel: str) -> None:
    one = certain(altered(sound, **{channel: np.negative}))
    assert (one.channel, one.kind) == (channel, Kind.SIGN) and f"column of {channel}" in one.remedy


@pytest.mark.long
@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 10_000),
    st.sampled_from(["alpha", "q", "nz", "elevator"]),
    st.sampled_from(["3211", "doublets", "sweep"]),
    st.sampled_from([20.0, 50.0, 100.0]),
)
def test_a_turned_sign_is_certain_for_any_aircraft(
    seed: int, channel: str, kind: str, rate: float
) -> None:
    rng = np.random.default_rng(seed)
    craft = drawn(rng)
    record = flight(rng, craft, kind, rate, 14.0, size=0.05, noise=0.3)
    assert [
        one for one in inspect(record, craft.expected) if one.certainty is Certainty.CERTAIN
    ] == []
    one = certain(altered(record, **{channel: np.negative}), craft.expected)
    assert (one.channel, one.kind) == (channel, Kind.SIGN)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("alpha", "q"),
        ("alpha", "nz"),
        ("q", "nz"),
        ("alpha", "elevator"),
        ("q", "elevator"),
        ("nz", "elevator"),
    ],
)
def test_two_exchanged_columns_are_certain(sound: Record, first: str, second: str) -> None:
    one = certain(exchanged(altered(sound, alpha=lambda v: v - 0.06), first, second))
    assert (one.channel, one.kind) == (f"{first} and {second}", Kind.EXCHANGED)


@pytest.mark.parametrize(
    ("channel", "factor"), [("alpha", DEGREES), ("q", DEGREES), ("elevator", DEGREES), ("nz", G0)]
)
def test_a_single_channel_in_another_unit_is_certain(channel: str, factor: float) -> None:
    """A small motion, so that no angle in degrees is too large for radians."""
    small = flight(np.random.default_rng(22), size=0.01, noise=0.3)
    one = certain(altered(small, **{channel: lambda v: factor * v}))
    assert (one.channel, one.kind) == (channel, Kind.UNIT)


def test_angles_too_large_for_radians_are_certain_without_any_other_channel(sound: Record) -> None:
    alone = Record(sound.time, (), (Channel.of("alpha", "rad", DEGREES * sound["alpha"].values),))
    one = certain(alone, Expectations())
    assert (one.channel, one.kind) == ("alpha", Kind.UNIT) and "alpha_deg" in one.remedy


def test_attitude_tells_which_of_two_angles_is_in_degrees() -> None:
    record = flight(
        np.random.default_rng(23), size=0.01, noise=0.3, outputs=("alpha", "q", "nz", "theta")
    )
    one = certain(altered(record, theta=lambda v: DEGREES * v))
    assert (one.channel, one.kind) == ("theta", Kind.UNIT)


def test_angles_in_degrees_without_a_pitch_rate_are_no_crash() -> None:
    record = flight(
        np.random.default_rng(27), size=0.01, noise=0.3, outputs=("alpha", "nz", "theta")
    )
    assert (
        inspect(
            altered(record, alpha=lambda v: DEGREES * v, theta=lambda v: DEGREES * v),
            Expectations(),
        )
        == ()
    )


def test_az_is_told_under_its_own_name(sound: Record) -> None:
    az = Channel.of("az", "m/s2", G0 * sound["nz"].values)
    one = certain(Record(sound.time, sound.inputs, (sound["alpha"], sound["q"], az)))
    assert (one.channel, one.kind) == ("az", Kind.SIGN) and "nz" not in one.sentence


@pytest.mark.parametrize("outputs", [("alpha", "q"), ("q", "nz")])
def test_two_channels_suffice_with_what_the_control_does(outputs: tuple[str, ...]) -> None:
    record = flight(np.random.default_rng(24), outputs=outputs)
    assert inspect(record, CRAFT.expected) == ()
    for channel in outputs:
        one = certain(altered(record, **{channel: np.negative}))
        assert one.kind is Kind.SIGN and channel in f"{one.channel} {one.sentence}"


def test_a_wrong_airspeed_is_named_beside_the_unit_of_the_load_factor(sound: Record) -> None:
    """In alpha_dot = q - (g/V) (nz - nz_0) a wrong V is a wrong factor of nz."""
    speed = CRAFT.expected.airspeed
    assert speed is not None
    finding = certain(sound, replace(CRAFT.expected, airspeed=speed / 10.0))
    assert finding.channel == "nz" and "m/s2" in finding.sentence
    assert finding.numbers["airspeed"].value == pytest.approx(speed, rel=0.1)
    assert "airspeed of the vehicle file" in finding.remedy


def test_milliseconds_for_seconds_are_certain(sound: Record) -> None:
    one = certain(altered(sound, time=lambda t: 1000.0 * t))
    assert (one.channel, one.kind) == ("time", Kind.TIME_BASE) and "time [ms]" in one.remedy


@pytest.mark.parametrize("factor", [0.5, 2.0, 4.0])
def test_a_clock_at_a_multiple_of_its_rate_is_noticed(sound: Record, factor: float) -> None:
    (one,) = inspect(altered(sound, time=lambda t: factor * t), CRAFT.expected)
    assert (one.channel, one.kind) == ("time", Kind.TIME_BASE)
    assert one.numbers["factor"].value == pytest.approx(1.0 / factor, rel=0.25)


@pytest.mark.parametrize(
    "effect",
    [
        lambda r: altered(r, time=lambda t: 1.1 * t),
        lambda r: altered(r, alpha=lambda v: 1.3 * v),
        lambda r: altered(r, q=lambda v: 0.8 * v),
        lambda r: altered(r, nz=lambda v: 0.7 * v),
        lambda r: altered(r, alpha=lambda v: np.concatenate([np.full(8, v[0]), v[:-8]])),
        lambda r: altered(r, q=lambda v: np.concatenate([np.full(8, v[0]), v[:-8]])),
        lambda r: altered(r, alpha=lambda v: v - 8.0 / CRAFT.airspeed * r["q"].values),
        lambda r: altered(r, nz=lambda v: v - 1.0 + 0.02 * r.time),
        lambda r: altered(r, elevator=lambda v: 0.5 * v),
    ],
)
def test_effects_of_sensors_are_left_to_the_fit(sound: Record, effect: object) -> None:
    assert callable(effect)
    smooth = flight(None, CRAFT)  # the shift of a noisy channel would be a run of its first sample
    assert [
        one for one in inspect(effect(smooth), CRAFT.expected) if one.certainty is Certainty.CERTAIN
    ] == []


def test_nothing_is_asked_where_nothing_moves_or_nothing_is_known() -> None:
    resting = flight(np.random.default_rng(25), kind="rest")
    assert inspect(resting, CRAFT.expected) == ()
    turned = altered(flight(np.random.default_rng(25)), elevator=np.negative)
    assert inspect(turned, Expectations(CRAFT.airspeed)) == ()
    rough = flight(np.random.default_rng(26), kind="rest", gust=0.01)
    assert inspect(rough, CRAFT.expected) == ()


def test_the_power_of_the_control_is_that_of_the_equations(sound: Record) -> None:
    columns = columns_of(sound, CRAFT.expected)
    assert columns is not None and max(disagreement(columns).values()) < 0.05
    found = control_power(columns)
    assert found is not None and found.explained > 0.95
    assert found.value == pytest.approx(CRAFT.power, rel=0.15)


@pytest.mark.parametrize("channel", ["alpha", "q", "nz", "elevator"])
def test_a_turned_sign_is_certain_beside_a_late_vane(channel: str) -> None:
    """The commonest other fault: alpha late by 0.15 s."""
    smooth = flight(np.random.default_rng(27), size=0.04, noise=0.3)
    late = altered(smooth, alpha=lambda v: np.concatenate([v[:8][::-1], v[:-8]]))
    assert inspect(late, CRAFT.expected) == ()
    one = certain(altered(late, **{channel: np.negative}))
    assert (one.channel, one.kind) == (channel, Kind.SIGN)


def test_a_scale_of_the_pitch_rate_is_no_clock() -> None:
    """To alpha and theta a gyro that reads six tenths is a clock that runs slow."""
    rng = np.random.default_rng(27)
    craft = drawn(rng)
    record = flight(rng, craft, duration=20.0, noise=0.5, outputs=("alpha", "q", "nz", "theta"))
    assert all(
        one.certainty is not Certainty.CERTAIN
        for one in inspect(altered(record, q=lambda v: 0.6 * v), craft.expected)
    )


def test_attitude_and_load_factor_tell_a_clock() -> None:
    record = flight(np.random.default_rng(28), outputs=("alpha", "q", "nz", "theta"))
    one = certain(altered(record, time=lambda t: 2.0 * t), Expectations(CRAFT.airspeed))
    assert (one.channel, one.kind) == ("time", Kind.TIME_BASE)


@pytest.mark.parametrize("seed", [10, 16, 31])
def test_an_accelerometer_ahead_is_not_refused_for_want_of_a_vane(seed: int) -> None:
    craft = drawn(np.random.default_rng(seed))
    record = flight(None, craft, duration=20.0, outputs=("q", "nz"))
    slope = np.gradient(record["q"].values, record.time)
    ahead = altered(record, nz=lambda v: v + 12.0 / G0 * slope)
    assert all(one.certainty is not Certainty.CERTAIN for one in inspect(ahead, craft.expected))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_very_late_vane_in_rough_air_turns_no_sign_of_the_control(seed: int) -> None:
    craft = Aircraft(
        lift=1.8, stiffness=-22.0, damping=-4.2, power=-6.1, elevator_lift=0.03, airspeed=111.0
    )
    record = flight(
        np.random.default_rng(seed), craft, "sweep", 50.0, 20.0, size=0.04, noise=0.5, gust=0.003
    )
    late = altered(record, alpha=lambda v: np.concatenate([np.full(10, v[0]), v[:-10]]))
    assert all(one.kind is not Kind.SIGN for one in inspect(late, craft.expected))
    turned = [one.kind for one in inspect(altered(record, elevator=np.negative), craft.expected)]
    assert turned == [Kind.SIGN]


def test_a_control_power_that_the_other_sign_explains_nearly_as_well_is_not_is_reliable() -> None:
    assert is_reliable(ControlPower(-40.0, 2.0, 0.95, 0.7)) and not is_reliable(
        ControlPower(-40.0, 2.0, 0.93, 0.81)
    )
    assert not is_reliable(ControlPower(-40.0, 6.0, 0.95, 0.0)) and not is_reliable(
        ControlPower(-40.0, 2.0, 0.75, 0.0)
    )


@pytest.mark.parametrize("lag", [1, 4, 9])
def test_the_sigma_of_a_control_power_counts_the_samples_of_a_lag_once(lag: int) -> None:
    """Each row repeated ``lag`` times tells no more; of single rows it is ordinary least
    squares.
    """
    rng = np.random.default_rng(1)
    first, second, moved = rng.standard_normal((3, 80))
    change = 0.3 * first - 0.7 * second - 4.0 * moved + 0.5 + 0.2 * rng.standard_normal(80)
    rows = np.stack([first, second, moved, np.ones(80)], axis=1)
    coefficients, (left,), _, _ = np.linalg.lstsq(rows, change, rcond=None)
    sigma = float(np.sqrt(left / 80 * np.linalg.inv(rows.T @ rows)[2, 2]))
    found = _control_power_fit(
        np.repeat(change, lag),
        [np.repeat(each, lag) for each in (first, second, moved)],
        lag,
    )
    assert found is not None
    assert (found.value, found.std) == pytest.approx((coefficients[2], sigma))
    assert found.explained == pytest.approx(1.0 - left / np.sum((change - change.mean()) ** 2))


def under_control(seed: int) -> tuple[Aircraft, Record]:
    """A flight under a controller in rough air, with or without a late vane."""
    rng = np.random.default_rng(seed)
    lift, stiffness, damping = rng.uniform(0.4, 1.5), rng.uniform(-4.0, 4.0), -rng.uniform(0.5, 2.0)
    craft = Aircraft(
        lift,
        stiffness,
        damping,
        -rng.uniform(5.0, 15.0),
        rng.uniform(0.0, 0.15),
        rng.uniform(80.0, 250.0),
    )
    law = Controller(
        rng.uniform(0.4, 1.3),
        rng.uniform(0.1, 0.8),
        float(rng.choice([0.0, 0.3])),
        rng.uniform(0.1, 0.8),
        bool(rng.integers(2)),
    )
    kind, size = (
        str(rng.choice(["3211", "doublets", "sweep", "steps"])),
        10.0 ** rng.uniform(-2.5, -1.7),
    )
    noise, late = float(rng.choice([0.3, 1.0, 2.0])), float(rng.choice([0.0, 0.1, 0.3]))
    return craft, controlled(rng, craft, law, kind, 50.0, 16.0, size, noise, 0.03, (1.0, late))


@pytest.mark.sampled
@pytest.mark.parametrize(
    "seed",
    [0, 12, 26, 56, 122, 141, 239, 297, 327, 4, 120, 235, 267, 277, 38, 67, 113],
    ids=lambda seed: f"flight-{seed}",
)
def test_an_elevator_that_a_controller_shapes_like_alpha_is_not_exchanged(seed: int) -> None:
    """Each of these was refused by kinematics alone: as exchanged, of turned sign, or on a clock of
    another unit.
    """
    craft, record = under_control(seed)
    assert [
        one for one in inspect(record, craft.expected) if one.certainty is Certainty.CERTAIN
    ] == []


@pytest.mark.parametrize(
    ("first", "second"), [("alpha", "elevator"), ("q", "elevator"), ("alpha", "q"), ("alpha", "nz")]
)
def test_columns_exchanged_under_a_controller_are_still_certain(first: str, second: str) -> None:
    """An unstable aircraft that is held by its controller, and as calm a day as records are made
    on.
    """
    craft = Aircraft(stiffness=1.5)
    record = controlled(
        np.random.default_rng(3),
        craft,
        Controller(0.5, 0.4, filter=0.05, inertial=False),
        size=0.06,
    )
    assert inspect(record, craft.expected) == ()
    one = certain(exchanged(altered(record, nz=lambda v: v - 1.0), first, second), craft.expected)
    assert (one.channel, one.kind) == (f"{first} and {second}", Kind.EXCHANGED)


def test_lift_belongs_to_the_angle_of_attack() -> None:
    """nz = a alpha + b delta: nothing is left with a > |b| > 0; with b the greater one the closest
    is a = |b|.
    """
    time = 0.02 * np.arange(800)
    alpha, delta = np.sin(1.3 * time), np.sin(2.9 * time + 1.0)

    def left(load: np.ndarray) -> float:
        columns = KinematicColumns(
            time, {"alpha": alpha, "q": np.cos(1.3 * time), "nz": load}, delta, "elevator", 0.1
        )
        found = unexplained_lift(columns)
        assert found is not None
        return found[0]

    assert left(9.0 * alpha - 2.0 * delta) < 1e-3 and left(9.0 * alpha + 2.0 * delta) < 1e-3
    assert left(-9.0 * alpha) > 0.9
    assert left(2.0 * alpha + 9.0 * delta) > 0.1


def test_an_exchange_with_the_control_without_a_load_factor_is_likely_only() -> None:
    """alpha and q alone: neither lift nor the size of the control's power can be asked beyond what
    kinematics say.
    """
    record = flight(np.random.default_rng(24), Aircraft(stiffness=-5.6), outputs=("alpha", "q"))
    (one,) = inspect(exchanged(record, "alpha", "elevator"), CRAFT.expected)
    assert (one.channel, one.kind, one.certainty) == (
        "alpha and elevator",
        Kind.EXCHANGED,
        Certainty.LIKELY,
    )


def test_no_clock_is_quicker_than_any_recorder() -> None:
    """Rows 20 ms apart are not 20 us apart, whatever the kinematics of a gust say; rows 20 s apart
    may be 20 ms.
    """
    columns = columns_of(flight(np.random.default_rng(7)), CRAFT.expected)
    assert columns is not None
    assert not [one for one in all_readings(columns) if one.kind is Kind.TIME_BASE]
    slow = all_readings(columns.scaled({"time": 1000.0}))
    assert [one.remedy for one in slow if one.kind is Kind.TIME_BASE] == [
        "name the column time [ms], or say its unit in a channel map"
    ]
