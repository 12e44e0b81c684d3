"""What the truth generator writes, step by step a second way: walking parameters, quantised and
lost samples, times, divergence.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim.declaration.model import Noise
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import ModelError
from sim.maneuvers import three_two_one_one
from sim.propagation import euler_step, make_grid
from sim.truth.flight import fly, refuse_divergence, sample_times
from sim.truth.measurement import Measurement, measure
from sim.vehicles.factory import ballistic_model, rigid_model
from sim.vehicles.library import read_parameter_set

RIGID = read_parameter_set("bomber_rigid")
QUIET = Measurement(std={})


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_each_euler_step_uses_the_parameter_that_has_walked_so_far() -> None:
    body = ballistic_model(read_parameter_set("ballistic_target")).with_noise(
        Noise({}, {"beta": 1e5})
    )
    times = sample_times(100.0, 20.0)
    _, truth = fly(body, None, times, generator(2), step=0.01, method=euler_step, measurement=QUIET)
    altitude, velocity, beta = (
        truth.states["altitude"],
        truth.states["velocity"],
        truth.walks["beta"],
    )
    p = {name: body.parameters[name].value for name in body.parameters.names}
    density = p["air_density_reference"] * np.exp(-altitude / p["density_scale_height"])
    rate = 0.5 * density * velocity**2 / beta - p["gravity"]
    assert np.ptp(beta) > 0.2 * beta[0]
    np.testing.assert_allclose(np.diff(velocity), 0.01 * rate[:-1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(altitude), 0.01 * velocity[:-1], rtol=0.0, atol=1e-8)


def test_a_lagging_sensor_is_fed_the_walk_of_both_ends_of_a_step() -> None:
    lag, step = 0.1, 0.01
    model = (
        rigid_model(RIGID, Noise({}, {"CL_alpha": 30.0}))
        .with_effects(SensorLag("nz"))
        .with_values({"sensor-lag:nz.time_constant": lag})
    )
    _, truth = fly(
        model,
        three_two_one_one(0.10471, 0.5, 0.2),
        sample_times(100.0, 4.0),
        generator(3),
        step=step,
        measurement=QUIET,
    )
    p = {name: model.parameters[name].value for name in model.parameters.names}
    alpha, q = truth.states["alpha"], truth.states["q"]
    elevator = three_two_one_one(0.10471, 0.5, 0.2)(truth.time)
    force = 0.5 * p["air_density"] * p["airspeed"] ** 2 * p["wing_area"] / (p["mass"] * 9.80665)
    rest = truth.walks["CL_alpha"] * alpha + p["CL_q"] * q * p["chord"] / (2.0 * p["airspeed"])
    begin, end = (
        force * (rest + p["CL_de"] * elevator),
        force * (rest[1:] + p["CL_de"] * elevator[:-1]),
    )
    # y_dot = (v - y)/lag with v straight from begin to end of each step: v - lag slope, and what is
    # left of the start.
    fade, reading = math.exp(-step / lag), [begin[0]]
    for v0, v1 in zip(begin, end, strict=False):
        slope = (v1 - v0) / step
        reading.append(v1 - lag * slope + (reading[-1] - (v0 - lag * slope)) * fade)
    np.testing.assert_allclose(truth.outputs["nz"], reading, rtol=0.0, atol=1e-9)
    assert np.max(np.abs(np.diff(truth.walks["CL_alpha"]))) > 0.5


def test_a_walk_of_no_density_draws_nothing() -> None:
    still, plain = (
        rigid_model(RIGID, Noise({"q": 0.003}, density))
        for density in ({"Cm_alpha": 0.0, "q": 0.0}, {})
    )
    records = [
        fly(model, None, sample_times(50.0, 2.0), generator(4))[0] for model in (still, plain)
    ]
    assert records[0]["q"].values.tobytes() == records[1]["q"].values.tobytes()


def test_quantised_samples_are_the_nearest_steps() -> None:
    clean = np.linspace(-1.0, 1.0, 20001)
    (channel,) = measure(
        np.arange(clean.size) * 0.01,
        {"q": clean},
        {"q": "rad/s"},
        generator(),
        Measurement(resolution={"q": 0.03}),
    )
    error = channel.values - clean
    assert np.max(np.abs(error)) <= 0.015 * (1.0 + 1e-9)
    assert abs(np.mean(error)) < 1e-4


def test_the_share_of_lost_samples_is_the_one_asked_for() -> None:
    n, share = 200_000, 0.25
    (channel,) = measure(
        np.arange(n) * 0.01,
        {"q": np.zeros(n)},
        {"q": "rad/s"},
        generator(),
        Measurement(missing={"q": share}),
    )
    assert np.mean(~channel.valid) == pytest.approx(
        share, abs=4.0 * math.sqrt(share * (1.0 - share) / n)
    )


def test_sample_times_run_from_their_start_to_their_end() -> None:
    times = sample_times(10.0, 1.0, start=3.0)
    assert (times[0], times[-1], times.size) == (3.0, 4.0, 11)


@pytest.mark.parametrize("first", [0, 7, 20])
def test_divergence_is_told_from_the_first_instant_that_is_not_finite(first: int) -> None:
    grid = make_grid(np.arange(11) * 0.2, 0.1)
    states = np.zeros((2, 21))
    states[1, first:] = np.inf
    with pytest.raises(ModelError, match=f"diverges at {0.1 * first:.4g} s"):
        refuse_divergence(rigid_model(RIGID), grid, [*states])
