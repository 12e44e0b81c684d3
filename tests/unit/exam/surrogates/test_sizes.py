"""Surrogate flights whose hidden effect has a declared size: drawn within its span, and acting as
kinematics and steady flight say.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from exam.surrogates.declaration import MEASURED, OPTIONAL, Hidden, Surrogate
from exam.surrogates.flights import flight
from exam.surrogates.flights.dominant import LEAST, draw_dominant, group
from exam.surrogates.flights.drawing import SPEED, Dominant, Drawn, draw, hiding
from exam.surrogates.flights.flying import fly_drawn, fly_draws
from exam.surrogates.flights.kinds import KINDS, SIZES, values_at
from exam.surrogates.flights.level import level_elevator, steered
from exam.surrogates.flights.maneuvers import maneuver
from exam.surrogates.schema import load_surrogate
from sim.effects.library import find_effect
from sim.errors import DeclarationError
from sim.record import Record
from tests.surrogates import ALL_CHANNELS, CALM, EVERY, short

G0 = 9.80665
# The effect of each, and its declared span: local parameter in SI, of the speed the share lost.
DEAR = ("surrogate-nose-boom", "surrogate-accelerometer")  # drawn anew until the size shows
DECLARED = {
    "surrogate-rough-air": ("gust-turbulence", 1.0, 2.5),
    "surrogate-deceleration": (SPEED, 0.07, 0.13),
    "surrogate-nose-boom": ("vane-offset", 3.0, 10.0),
    "surrogate-accelerometer": ("accelerometer-offset:nz", 1.5, 5.0),
}
SMALLER = ("flight.duration=12", "flight.records=[2,2]", "flight.step=0.02", "flight.rates=[25]")


def plan(**changes: Any) -> Drawn:
    return draw(
        short(replace(CALM, gravity=1.0, trim_lift=1.0), rates=(100.0,), step=0.01, **changes),
        np.random.default_rng(5),
    )


def with_effect(drawn: Drawn, name: str, size: float, sign: float = 1.0) -> Drawn:
    count = tuple(range(len(drawn.maneuvers)))
    return hiding(
        drawn,
        (
            Dominant(
                find_effect(name, drawn.model.equations), values_at(drawn, name, size, sign), count
            ),
        ),
    )


def flown(drawn: Drawn, seed: int = 6) -> Record:
    return fly_drawn(drawn, np.random.default_rng(seed), count=1)[0].record


def size_of(drawn: Drawn) -> float:
    (item,) = drawn.hidden
    value = item.values[SIZES[item.name].local]
    return (
        -value * drawn.surrogate.flight.duration / drawn.declared.parameters["airspeed"].value
        if item.name == SPEED
        else value
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in DEAR else ()) for name in DECLARED],
)
def test_the_catalogue_declares_what_it_says_and_draws_within(name: str) -> None:
    effect, low, high = DECLARED[name]
    surrogate = load_surrogate(name, SMALLER)
    assert surrogate.hidden.count == 1 and surrogate.hidden.names == (effect,)
    assert surrogate.hidden.sizes == {effect: pytest.approx((low, high))}
    drawn = [
        draw_dominant(draw(surrogate, np.random.default_rng(seed)), np.random.default_rng(seed))
        for seed in range(4)
    ]
    sizes = [size_of(one) for one in drawn]
    assert len(set(sizes)) == 4 and all(low <= abs(size) <= high for size in sizes)
    assert all(one.hidden[0].records == (0, 1) for one in drawn)
    assert (min(sizes) < 0.0) == (name == "surrogate-accelerometer"), (
        "an accelerometer may sit behind, a vane not"
    )


def test_an_arm_of_the_vane_takes_its_share_of_the_pitch_rate() -> None:
    before, after = flown(plan()), flown(with_effect(plan(), "vane-offset", 6.0))
    wanted = -6.0 / before["airspeed"].values * before["q"].values
    assert (
        np.allclose(after["alpha"].values - before["alpha"].values, wanted, atol=1e-12)
        and np.ptp(wanted) > 0.005
    )
    assert np.array_equal(after["nz"].values, before["nz"].values)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_accelerometer_ahead_or_behind_feels_the_pitch_acceleration(sign: float) -> None:
    before, after = flown(plan()), flown(with_effect(plan(), "accelerometer-offset:nz", 3.0, sign))
    wanted = sign * 3.0 / G0 * np.gradient(before["q"].values, before.time)
    difference = after["nz"].values - before["nz"].values
    # A central difference over 0.02 s of a rate that bends within 0.05 s.
    assert (
        np.allclose(difference, wanted, atol=0.05 * float(np.ptp(wanted))) and np.ptp(wanted) > 0.1
    )
    assert np.array_equal(after["alpha"].values, before["alpha"].values)


@pytest.mark.long
def test_gusts_are_as_strong_as_drawn() -> None:
    """Kinematics gives them back without aerodynamics: alpha - theta + climb = w/V, the climb from
    the load factor alone.
    """
    calm, squares = plan(duration=60.0), []
    rough = with_effect(calm, "gust-turbulence", 2.0)
    for seed in range(8):
        record = flown(rough, seed)
        speed, nz = record["airspeed"].values, record["nz"].values
        climb = np.zeros(len(record))
        for k in range(len(record) - 1):
            climb[k + 1] = climb[k] + (record.time[k + 1] - record.time[k]) * G0 / speed[k] * (
                0.5 * (nz[k] + nz[k + 1]) - math.cos(climb[k])
            )
        gust = speed * (record["alpha"].values - record["theta"].values + climb)
        squares.append(float(np.mean((gust - gust.mean()) ** 2)))
    # A record of 60 s has about 60 V/(2 L) = 13 independent pieces, eight have 104: the variance is
    # known to a seventh, one sigma.
    assert 0.6 < np.mean(squares) / 4.0 < 1.4


@pytest.mark.parametrize("level", [False, True])
def test_a_pilot_who_holds_the_height_loses_the_declared_share_of_the_speed(level: bool) -> None:
    """In level flight V_dot is thrust less drag over the mass; without the pilot the path bends
    down and gives the speed back.
    """
    drawn = with_effect(plan(duration=25.0, amplitude=(1e-6, 1e-6), level=level), SPEED, 0.1)
    record = flown(drawn)
    lost = 1.0 - record["airspeed"].values[-1] / record["airspeed"].values[0]
    climb = record["theta"].values - record["alpha"].values
    if level:
        assert lost == pytest.approx(0.1, abs=0.003) and np.max(np.abs(climb)) < 0.004
        assert np.allclose(record["nz"].values, 1.0, atol=0.005)
    else:
        assert lost < 0.06 and climb[-1] < -0.02


def test_the_level_elevator_is_that_of_steady_flight() -> None:
    """Two linear equations for angle of attack and elevator, by a solver; and the flights flown at
    once have it, too.
    """
    drawn = plan(level=True)
    p = {item.name: item.value for item in drawn.model.parameters}
    speed = 0.9 * p["airspeed"]
    weight = 2.0 * p["mass"] * G0 / (p["air_density"] * p["wing_area"])
    wanted = np.linalg.solve(
        [[p["CL_alpha"], p["CL_de"]], [p["Cm_alpha"], p["Cm_de"]]],
        [weight / speed**2 - weight / p["airspeed"] ** 2, 0.0],
    )
    assert level_elevator(drawn, np.array([0.0, speed - p["airspeed"]])) == pytest.approx(
        [0.0, wanted[1]]
    )
    assert steered(drawn, 0) is drawn.maneuvers[0], "nothing changes the speed"
    slowing = with_effect(drawn, SPEED, 0.1)
    at_once = fly_draws(slowing, np.random.default_rng(6).spawn(1), ALL_CHANNELS)[0][0]
    alone = fly_drawn(slowing, np.random.default_rng(6).spawn(1)[0], noise=False)[0].record
    assert all(
        np.allclose(a.values, b.values, rtol=0.0, atol=1e-10)
        for a, b in zip(at_once.channels, alone.channels, strict=True)
    )
    assert alone["elevator"].values[-1] - flown(drawn)["elevator"].values[-1] == pytest.approx(
        wanted[1], rel=0.02
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_step_is_held_for_most_of_the_record(seed: int) -> None:
    move = maneuver("step", np.random.default_rng(seed), 0.01, 0.4, 10.0, 20.0)
    t = np.arange(0.0, 10.0, 0.01)
    size = np.abs(move(t))
    assert 0.55 < np.mean(size > 0.99 * 0.01) < 0.8
    assert np.max(size) <= 0.01 + 1e-12 and size[0] == 0.0 and size[-1] < 1e-5
    assert np.ptp(np.sign(move(t))) == 1.0, "one way only"


def test_the_steps_flight_flies_nothing_else_and_hides_what_surrogate_one_hides() -> None:
    surrogate, one = (load_surrogate(name) for name in ("surrogate-steps", "surrogate-one"))
    assert surrogate.flight.maneuvers == ("step",) and surrogate.hidden == one.hidden
    assert set(draw(surrogate, np.random.default_rng(1)).kinds) == {"step"}
    assert "step" not in one.flight.maneuvers


@pytest.mark.parametrize("seed", range(6))
def test_the_step_flight_has_one_record_that_is_a_held_step_and_else_what_surrogate_one_flies(
    seed: int,
) -> None:
    surrogate, one = (load_surrogate(name) for name in ("surrogate-step", "surrogate-one"))
    assert (
        surrogate.hidden == one.hidden
        and surrogate.causes == one.causes
        and surrogate.flight.maneuvers == one.flight.maneuvers
    )
    kinds, others = (draw(each, np.random.default_rng(seed)).kinds for each in (surrogate, one))
    assert kinds.count("held") == 1 and "held" not in others
    assert sum(kind != other for kind, other in zip(kinds, others, strict=True)) == 1


@pytest.mark.parametrize("seed", range(5))
def test_a_held_step_is_a_third_as_large_and_stays_for_a_third_of_the_record(seed: int) -> None:
    move = maneuver("held", np.random.default_rng(seed), 0.03, 0.4, 25.0, 20.0)
    t = np.arange(0.0, 25.0, 0.01)
    size = np.abs(move(t))
    assert 0.28 < np.mean(size > 0.99 * 0.01) < 0.42 and np.max(size) <= 0.01 + 1e-12
    assert np.ptp(np.sign(move(t))) == 1.0 and size[0] == 0.0 and size[-1] < 1e-5


def test_what_is_not_recorded_is_not_told_and_moves_no_other_draw() -> None:
    plain, silent = plan(), plan(unrecorded=("airspeed", "dynamic_pressure"))
    assert silent.channels == (*MEASURED, "theta", "ax")
    first, second = flown(plain), flown(silent)
    assert all(np.array_equal(first[name].values, second[name].values) for name in silent.channels)
    surrogate = load_surrogate("surrogate-deceleration")
    assert all(
        not {"airspeed", "dynamic_pressure"}
        & set(draw(surrogate, np.random.default_rng(seed)).channels)
        for seed in range(8)
    )


@pytest.mark.long
def test_a_size_too_small_to_show_is_drawn_larger_or_passed_over() -> None:
    def hidden(low: float, high: float) -> Surrogate:
        return replace(
            short(EVERY, step=0.02),
            hidden=Hidden(1, ("vane-offset",), sizes={"vane-offset": (low, high)}),
        )

    def drawn(surrogate: Surrogate) -> Drawn:
        return draw_dominant(draw(surrogate, np.random.default_rng(3)), np.random.default_rng(4))

    assert 0.01 < size_of(drawn(hidden(0.01, 30.0))) <= 30.0
    with pytest.raises(DeclarationError, match="0 of 1 effects make a difference"):
        drawn(hidden(0.001, 0.002))
    assert LEAST > 0.0 and set(SIZES) <= set(KINDS)
    assert (
        group("accelerometer-offset:nz")
        == group("vane-offset")
        == group("sensor-lag:alpha")
        == "late alpha"
    )


@pytest.mark.parametrize(("sizes", "tried"), [({"vane-offset": (0.001, 0.002)}, 5), ({}, 1)])
def test_an_aircraft_on_which_no_declared_size_shows_is_drawn_anew(
    sizes: dict[str, tuple[float, float]], tried: int
) -> None:
    seen: list[float] = []

    def refused(drawn: Drawn, rng: np.random.Generator) -> Drawn:
        seen.append(drawn.declared.parameters["Cm_alpha"].value)
        raise DeclarationError(
            "only 0 of 1 effects make a difference on this flight",
            where="key hidden",
            remedy="ask for more",
        )

    surrogate = replace(short(), hidden=Hidden(1, ("vane-offset",), sizes=sizes))
    with (
        pytest.MonkeyPatch.context() as patch,
        pytest.raises(DeclarationError, match="make a difference"),
    ):
        patch.setattr(flight, "draw_dominant", refused)
        flight.fly_surrogate(surrogate, 1)
    assert len(seen) == len(set(seen)) == tried


@pytest.mark.parametrize(
    ("name", "change", "what"),
    [
        (
            "surrogate-one",
            "hidden.sizes={gust-turbulence=[1,2]}",
            "there is no name hidden here 'gust-turbulence'",
        ),
        (
            "surrogate-one",
            "hidden.sizes={input-delay=[0.1,0.2]}",
            "there is no effect of declared size 'input-delay'",
        ),
        ("surrogate-rough-air", "hidden.sizes={gust-turbulence=[2,1]}", "sizes.gust-turbulence"),
        ("surrogate-rough-air", "hidden.sizes={gust-turbulence=[0,1]}", "is not above 0"),
        ("surrogate-rough-air", "hidden.sizes={gust-turbulence=[1,20]}", "20 is too large"),
        (
            "surrogate-rough-air",
            "hidden.sizes={gust-turbulence=['1 kg','2 kg']}",
            "sizes.gust-turbulence",
        ),
        (
            "surrogate-rough-air",
            "hidden.sizes={gust-turbulence=[1]}",
            "hidden.sizes.gust-turbulence",
        ),
        ("surrogate-deceleration", "hidden.sizes={speed-variation=[0.1,0.9]}", "0.9 is too large"),
        ("surrogate-deceleration", "flight.unrecorded=['q']", "there is no further channel 'q'"),
        ("surrogate-deceleration", "flight.level=2", "flight.level"),
        ("surrogate-step", "flight.maneuvers=['steps']", "there is no maneuver 'steps'"),
        ("surrogate-step", "flight.once='holding'", "there is no maneuver 'holding'"),
    ],
)
def test_what_a_declaration_refuses(name: str, change: str, what: str) -> None:
    with pytest.raises(DeclarationError, match=what):
        load_surrogate(name, (change,))


def test_further_channels_are_the_optional_ones() -> None:
    assert set(load_surrogate("surrogate-deceleration").flight.unrecorded) < set(OPTIONAL)
