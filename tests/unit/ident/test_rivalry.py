"""Bounds, rivals and decisions against second writings: finite differences of whole flights, least
squares by scipy, simulated noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import ncx2

from ident.maneuver_design import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    ActingEffect,
    PlannedManeuver,
    RivalDecision,
    contest,
    detection_probability,
    linear_squares,
    rival_decision,
    shared_sigmas,
    simulate_maneuver,
)
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.effects.library import find_effect
from sim.maneuvers import three_two_one_one
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import model_from_constants

CONSTANTS = {
    "mass": 7500.0,
    "wing_area": 30.0,
    "chord": 2.4,
    "pitch_inertia": 32000.0,
    "airspeed": 130.0,
    "air_density": 0.96,
}
DERIVATIVES = {
    "CL_alpha": 5.2,
    "CL_q": 7.0,
    "CL_de": 0.4,
    "Cm_alpha": -0.95,
    "Cm_q": -17.0,
    "Cm_de": -1.3,
}
NOISE = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012}
MANEUVER = three_two_one_one(0.04, 0.4, 1.0)
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g"}


def plain() -> Model:
    return model_from_constants("rigid", CONSTANTS, DERIVATIVES).with_noise(Noise())


def planned(duration: float = 8.0) -> PlannedManeuver:
    time = sample_times(50.0, duration)
    outputs = tuple(Channel.of(name, unit, np.zeros(len(time))) for name, unit in UNITS.items())
    record = Record(time, (Channel.of("elevator", "rad", MANEUVER(time)),), outputs)
    return PlannedManeuver(
        record, plain().with_biases([*UNITS]), tuple(UNITS), np.array([*NOISE.values()])
    )


def flown(model: Model, plan: PlannedManeuver) -> np.ndarray:
    """Outputs ``(m, N)`` by the truth generator."""
    record, _ = fly(model, MANEUVER, plan.record.time, np.random.default_rng(0), step=0.002)
    return record.output_array(plan.outputs)[0]


def acting(name: str, **values: float) -> ActingEffect:
    effect = find_effect(name, plain().equations)
    assert isinstance(effect, Traceable)
    return ActingEffect(effect, {**{item.name: item.value for item in effect.parameters}, **values})


def test_expected_sigmas_are_the_bounds_by_differences_of_flights() -> None:
    plan, model = planned(), plain()
    sigma = plan.noise[:, None]
    columns = []
    for name, value in DERIVATIVES.items():
        step = 1e-4 * abs(value)
        both = [
            flown(model.with_values({name: value + way * step}), plan) / sigma
            for way in (1.0, -1.0)
        ]
        columns.append((both[0] - both[1]).ravel() / (2.0 * step))
    for name in ("alpha", "q"):
        moved = [
            flown(model.with_initial(model.initial.with_values({name: way * 1e-4})), plan) / sigma
            for way in (1.0, -1.0)
        ]
        columns.append((moved[0] - moved[1]).ravel() / 2e-4)
    for row in range(3):
        one = np.zeros((3, len(plan.record)))
        one[row] = 1.0 / plan.noise[row]
        columns.append(one.ravel())
    information = np.array(columns) @ np.array(columns).T
    bounds = np.sqrt(np.diag(np.linalg.inv(information)))[: len(DERIVATIVES)]
    found = shared_sigmas(simulate_maneuver(plan).fit)
    assert list(found) == [*DERIVATIVES]
    assert [*found.values()] == pytest.approx(bounds, rel=2e-3)


def test_a_simulation_is_the_flight() -> None:
    plan, true = planned(), acting("sensor-lag:alpha", time_constant=0.04)
    model = plain().with_effects(true.effect).with_values(true.full_values)
    mine = simulate_maneuver(plan, (true.effect,), true.full_values).fit.linearisations[0].y
    assert np.max(np.abs(mine - flown(model, plan)) / plan.noise[:, None]) < 0.02


@pytest.mark.slow
def test_the_rival_fits_as_well_as_plain_least_squares_can() -> None:
    plan, true = planned(5.0), acting("sensor-lag:alpha", time_constant=0.02)
    found = contest(plan, true, find_effect("vane-offset", plain().equations))  # type: ignore[arg-type]
    clean = flown(plain().with_effects(true.effect).with_values(true.full_values), plan)
    rival = find_effect("vane-offset", plain().equations)
    model = plain().with_effects(rival)

    def left(theta: np.ndarray) -> np.ndarray:
        values = {**dict(zip(DERIVATIVES, theta[:6], strict=True)), "vane-offset.arm": theta[6]}
        start = model.initial.with_values({"alpha": theta[7], "q": theta[8]})
        y = flown(model.with_values(values).with_initial(start), plan) + theta[9:, None]
        return ((clean - y) / plan.noise[:, None]).ravel()

    theta = np.array([*DERIVATIVES.values(), found.rival.values["arm"], *np.zeros(5)])
    best = least_squares(
        left,
        theta,
        x_scale=np.array([*map(abs, DERIVATIVES.values()), 1.0, *[0.01] * 5]),
        max_nfev=4,
    )
    assert 2.0 * found.left == pytest.approx(2.0 * best.cost, rel=0.02)
    assert linear_squares(plan, true, found.rival) == pytest.approx(2.0 * found.left, rel=0.1)


def test_the_difference_of_log_likelihoods_scatters_as_told() -> None:
    """Two lines through a plane, fitted to a thousand noisy points along the first: no engine of
    ours.
    """
    rng = np.random.default_rng(5)
    one, cosine, size = np.array([1.0, 0.0]), 0.9, 6.0
    other = np.array([cosine, math.sqrt(1.0 - cosine**2)])
    z = size * one + rng.standard_normal((20_000, 2))
    difference = (z @ one) ** 2 - (z @ other) ** 2
    left = size**2 * (1.0 - cosine**2)
    told = rival_decision(np.array([left]), np.array([10**9]), size**2, 1, 1)
    assert difference.mean() == pytest.approx(told.mean, abs=0.1)
    assert difference.std() == pytest.approx(told.std, rel=0.02)
    assert np.mean(difference > DECISIVE_LOG_LIKELIHOOD_RATIO) == pytest.approx(
        told.right, abs=0.02
    )
    assert np.mean(difference < -DECISIVE_LOG_LIKELIHOOD_RATIO) == pytest.approx(
        told.wrong, abs=0.02
    )


@pytest.mark.sampled
@pytest.mark.parametrize("share", [0.1, 1.0, 3.0])
def test_where_noise_levels_are_estimated_the_difference_is_that_of_logarithms(
    share: float,
) -> None:
    """N ln(sum (e + d)^2 / sum e^2) of 300 drawn samples, d of weighted squares ``share`` N: mean
    and scatter over 20,000 draws.
    """
    rng, count, runs = np.random.default_rng(6), 300, 20_000
    e = rng.standard_normal((runs, count))
    difference = count * np.log(np.sum((e + math.sqrt(share)) ** 2, axis=1) / np.sum(e**2, axis=1))
    told = rival_decision(np.array([share * count]), np.array([count]), 1e12, 2, 2)
    assert told.mean == pytest.approx(difference.mean(), rel=0.02)
    assert told.std == pytest.approx(difference.std(), rel=0.03)


@pytest.mark.parametrize("own", [1, 3])
@pytest.mark.parametrize("away", [-1.0, 0.0, 1.0])
def test_an_effect_is_found_as_often_as_a_noncentral_chi_squared_exceeds_its_price(
    own: int, away: float
) -> None:
    gain = 60.0
    limit = 2.0 * gain + own + away * math.sqrt(8.0 * gain)
    expected = ncx2.sf(limit, own, 2.0 * gain)
    assert detection_probability(gain, own, limit - 10.0, 10.0) == pytest.approx(expected, abs=0.02)


def test_what_leaves_nothing_decides_nothing() -> None:
    nothing = rival_decision(np.zeros(3), np.full(3, 400), 500.0, 1, 1)
    assert nothing.right < 0.01 and nothing.wrong < 0.01
    assert RivalDecision(100.0, 20.0).right > 0.999
    assert (
        detection_probability(0.5, 1, 6.0, 10.0)
        < 0.01
        < 0.99
        < detection_probability(50.0, 1, 6.0, 10.0)
    )


def test_effects_that_no_record_tells_apart_are_told_by_no_maneuver() -> None:
    plan = planned()
    both = contest(
        plan,
        acting("vane-offset", arm=5.0),
        find_effect("accelerometer-offset:nz", plain().equations),  # type: ignore[arg-type]
    )
    assert both.shown > 0.99 and both.left < 1e-3 and both.chance < 0.01


def test_a_longer_flight_tells_more() -> None:
    short, long = (shared_sigmas(simulate_maneuver(replace(planned(t))).fit) for t in (4.0, 8.0))
    assert all(long[name] < short[name] for name in short)
