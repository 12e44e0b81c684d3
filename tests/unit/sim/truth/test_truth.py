"""Flying a model: exact switching, noise by the model or as asked, same seed same bytes, truth
apart from the record.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from sim.declaration.model import Model, Noise
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import ModelError
from sim.maneuvers import Delayed, Sweep, pulse, step, three_two_one_one
from sim.propagation import euler_step, rk4_step
from sim.record import Hold
from sim.truth.flight import Distance, fly, remeasure, sample_times
from sim.truth.measurement import Measurement
from sim.vehicles.factory import ballistic_model, linearise, rigid_model
from sim.vehicles.library import read_parameter_set
from tests.bases import longitudinal_model

MANEUVER = three_two_one_one(0.10471, 0.5, 1.0)
STD = {"alpha": 0.002, "q": 0.003, "nz": 0.02}
TIME = sample_times(50.0, 6.0)
QUIET = Measurement(std={})


def rigid(noise: Noise | None = None) -> Model:
    return rigid_model(read_parameter_set("bomber_rigid"), noise)


def without_airspeed() -> Model:
    """Rates over an airspeed that is none."""
    model = longitudinal_model()
    return model.with_initial(model.initial.with_values({"airspeed": 0.0}))


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def exact_states(times: np.ndarray, unit: float, start: float) -> np.ndarray:
    """States of the linear aircraft under MANEUVER-like steps by matrix exponentials from switch to
    switch.
    """
    linear = linearise(rigid())
    maneuver = three_two_one_one(0.10471, unit, start)
    cuts = sorted({*times.tolist(), *maneuver.times})
    x, at = np.zeros(2), {0.0: np.zeros(2)}
    for a, b in pairwise(cuts):
        block = np.zeros((3, 3))
        block[:2, :2], block[:2, 2] = linear.A, linear.B[:, 0] * float(maneuver(a))
        x = (expm(block * (b - a)) @ np.append(x, 1.0))[:2]
        at[b] = x
    return np.array([at[t] for t in times.tolist()]).T


# A switch inside a sub-step keeps its impulse; what is left is |A B du| dt^2 / 8 each, here 1.4e-7
# rad for five switches.
@pytest.mark.parametrize(
    ("unit", "start", "tolerance"), [(0.5, 1.0, 1e-11), (0.50037, 1.00021, 7e-7)]
)
def test_states_follow_switches_at_their_own_time(
    unit: float, start: float, tolerance: float
) -> None:
    _, truth = fly(
        rigid(), three_two_one_one(0.10471, unit, start), TIME, generator(), measurement=QUIET
    )
    exact = exact_states(TIME, unit, start)
    assert np.max(np.abs(truth.states["alpha"] - exact[0])) < tolerance
    assert np.max(np.abs(truth.states["q"] - exact[1])) < tolerance


def test_smooth_input_keeps_the_order_of_the_integrator() -> None:
    sweep = Sweep(0.05, 1.0, 9.0, 6.0, taper=0.5)

    def error(size: float) -> float:
        _, truth = fly(
            rigid(), sweep, TIME, generator(), measurement=QUIET, step=size, method=rk4_step
        )
        return float(np.max(np.abs(truth.states["q"] - reference)))

    reference = fly(rigid(), sweep, TIME, generator(), measurement=QUIET)[1].states["q"]
    assert math.log2(error(0.02) / error(0.01)) == pytest.approx(4.0, abs=0.4)


def test_recorded_input_is_the_sample_and_the_hold_that_of_the_maneuver() -> None:
    record, _ = fly(rigid(), MANEUVER, TIME, generator(), measurement=QUIET)
    assert record.hold is Hold.PREVIOUS
    assert np.array_equal(record["elevator"].values, MANEUVER(TIME))
    assert record["elevator"].unit == "rad"
    assert [record[name].unit for name in record.output_names] == ["rad", "rad/s", "g"]
    assert (
        fly(rigid(), Sweep(0.1, 1.0, 2.0, 3.0), TIME, generator(), measurement=QUIET)[0].hold
        is Hold.LINEAR
    )


def test_outputs_jump_with_the_input_at_a_sample() -> None:
    record, truth = fly(rigid(), step(0.1, 1.0), TIME, generator(), measurement=QUIET)
    k = int(np.flatnonzero(TIME >= 1.0)[0])
    lift = truth.parameters["CL_de"].value * 0.1
    pressure_area = 0.5 * 1.055547358 * 200.64984**2 * 180.78931584
    assert truth.states["q"][k] == 0.0
    assert record["nz"].values[k] == pytest.approx(
        pressure_area * lift / (130642.3136463 * 9.80665), rel=1e-12
    )
    assert record["nz"].values[k - 1] == 0.0


def test_measurement_noise_is_the_models_and_white() -> None:
    record, truth = fly(rigid(Noise(STD)), MANEUVER, sample_times(500.0, 8.0), generator(3))
    n = len(record)
    assert truth.noise_std == STD
    for name, std in STD.items():
        error = record[name].values - truth.outputs[name]
        assert np.var(error) == pytest.approx(std**2, abs=4 * std**2 * math.sqrt(2 / n))
        assert np.mean(error[1:] * error[:-1]) == pytest.approx(0.0, abs=4 * std**2 / math.sqrt(n))


def test_coloured_noise_quantisation_and_losses_come_as_asked() -> None:
    measurement = Measurement(
        std=STD, correlation_time={"alpha": 0.5}, resolution={"q": 0.01}, missing={"nz": 0.25}
    )
    record, truth = fly(
        rigid(), MANEUVER, sample_times(100.0, 20.0), generator(4), measurement=measurement
    )
    alpha = record["alpha"].values - truth.outputs["alpha"]
    # One-step correlation exp(-0.02); its standard error is sqrt((1 - a^2) / N).
    a = math.exp(-0.01 / 0.5)
    assert np.sum(alpha[1:] * alpha[:-1]) / np.sum(alpha**2) == pytest.approx(
        a, abs=4 * math.sqrt((1 - a * a) / len(record)) + 2e-3
    )
    steps = record["q"].values / 0.01
    assert np.max(np.abs(steps - np.round(steps))) < 1e-9
    assert np.std(record["q"].values - truth.outputs["q"]) > 0.003
    lost = np.mean(~record["nz"].valid)
    assert lost == pytest.approx(0.25, abs=4 * math.sqrt(0.25 * 0.75 / len(record)))
    assert np.all(record["alpha"].valid)


def test_same_seed_same_bytes_and_other_seed_other_noise() -> None:
    noise = Noise(STD, {"alpha": 1e-5, "Cm_alpha": 1e-3})
    make = [fly(rigid(noise), MANEUVER, TIME, generator(seed))[0] for seed in (5, 5, 6)]
    assert all(make[0][name].values.tobytes() == make[1][name].values.tobytes() for name in STD)
    assert all(np.any(make[0][name].values != make[2][name].values) for name in STD)


@pytest.mark.long
def test_state_forcing_has_the_variance_of_its_density() -> None:
    density, runs = 2e-3, 150
    model, short = rigid(Noise({}, {"q": density})), sample_times(10.0, 0.6)
    ends = np.array(
        [
            fly(model, None, short, generator(seed), step=0.004)[1].states["q"][-1]
            for seed in range(runs)
        ]
    )
    # Lyapunov integral of the linear aircraft from rest.
    A, s = linearise(rigid()).A, np.linspace(0.0, 0.6, 601)
    column = np.array([expm(A * t)[1, 1] for t in s])
    expected = density * np.trapezoid(column**2, s)
    assert np.mean(ends**2) == pytest.approx(expected, abs=4 * expected * math.sqrt(2 / runs))


def test_parameter_walks_at_its_density_and_the_truth_keeps_it() -> None:
    body = ballistic_model(read_parameter_set("ballistic_target"))
    density = 57.0 * 4.882427636**2
    walking = body.with_noise(Noise({"altitude": 7.62}, {"beta": density}))
    _, truth = fly(walking, None, sample_times(10.0, 20.0), generator(7), step=0.01)
    walk = truth.walks["beta"]
    assert walk[0] == body.parameters["beta"].value
    assert np.mean(np.diff(walk) ** 2) == pytest.approx(
        density * 0.1, abs=4 * density * 0.1 * math.sqrt(2 / 200)
    )
    steady = fly(body, None, sample_times(10.0, 20.0), generator(7), step=0.01, measurement=QUIET)[
        1
    ]
    assert np.max(np.abs(truth.states["altitude"] - steady.states["altitude"])) > 1.0
    assert not steady.walks


def test_output_sees_a_parameter_that_walks() -> None:
    _, truth = fly(
        rigid(Noise({}, {"CL_de": 1.0})), step(0.1), sample_times(20.0, 1.0), generator(8)
    )
    pressure_area = 0.5 * 1.055547358 * 200.64984**2 * 180.78931584
    p = truth.parameters
    q_hat = truth.states["q"] * p["chord"].value / (2 * p["airspeed"].value)
    lift = (
        p["CL_alpha"].value * truth.states["alpha"]
        + p["CL_q"].value * q_hat
        + truth.walks["CL_de"] * 0.1
    )
    assert truth.outputs["nz"] == pytest.approx(
        pressure_area * lift / (p["mass"].value * 9.80665), rel=1e-12
    )


def test_input_path_acts_on_exact_means() -> None:
    delayed = rigid().with_effects(InputDelay("elevator")).with_values({"input-delay.delay": 0.06})
    record, truth = fly(
        delayed,
        pulse(0.1, 0.8, 1.0),
        TIME,
        generator(),
        measurement=QUIET,
        distance=Distance.EFFECT_MISSING,
    )
    later = fly(rigid(), Delayed(pulse(0.1, 0.8, 1.0), 0.06), TIME, generator(), measurement=QUIET)[
        1
    ]
    assert truth.effects == ("input-delay",)
    assert truth.distance is Distance.EFFECT_MISSING
    assert truth.states["q"] == pytest.approx(later.states["q"], abs=1e-9)
    assert np.array_equal(record["elevator"].values, pulse(0.1, 0.8, 1.0)(TIME))


def test_remeasuring_costs_no_flight_and_equals_flying_again() -> None:
    model = rigid(Noise(STD))
    record, truth = fly(model, MANEUVER, TIME, generator(1))
    again, fresh = (
        remeasure(record, truth, generator(9)),
        fly(model, MANEUVER, TIME, generator(9))[0],
    )
    assert all(again[name].values.tobytes() == fresh[name].values.tobytes() for name in STD)
    assert np.array_equal(again["elevator"].values, record["elevator"].values)


def test_method_and_step_are_told() -> None:
    _, truth = fly(
        rigid(), MANEUVER, TIME, generator(), measurement=QUIET, step=0.005, method=euler_step
    )
    _, fine = fly(
        rigid(), MANEUVER, TIME, generator(), measurement=QUIET, step=0.005, method=rk4_step
    )
    assert (truth.method, fine.method) == ("euler_step", "rk4_step")
    assert truth.step == pytest.approx(0.005)
    assert 1e-5 < np.max(np.abs(truth.states["alpha"] - fine.states["alpha"])) < 1e-2


def test_uneven_times_are_flown_as_they_are() -> None:
    uneven = np.cumsum(np.tile([0.01, 0.05, 0.3], 12))
    record, truth = fly(rigid(), MANEUVER, uneven, generator(), measurement=QUIET)
    assert np.array_equal(record.time, uneven)
    linear = fly(
        rigid(), MANEUVER, np.arange(uneven[0], 4.4, 0.01), generator(), measurement=QUIET
    )[1]
    at = np.searchsorted(linear.time, uneven - 1e-6)
    keep = uneven < 4.3
    assert truth.states["q"][keep] == pytest.approx(linear.states["q"][at[keep]], abs=1e-9)


def test_chosen_outputs_only() -> None:
    record, truth = fly(rigid(Noise(STD)), MANEUVER, TIME, generator(), outputs=["q", "alpha"])
    assert record.output_names == ("q", "alpha")
    assert tuple(truth.outputs) == ("q", "alpha")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda: fly(rigid(), {"rudder": MANEUVER}, TIME, generator()), "no input 'rudder'"),
        (
            lambda: fly(
                ballistic_model(read_parameter_set("ballistic_target")), MANEUVER, TIME, generator()
            ),
            "for 0 inputs",
        ),
        (lambda: fly(rigid(Noise({}, {"nonsense": 1.0})), None, TIME, generator()), "nonsense"),
        (
            lambda: fly(
                rigid(), None, TIME, generator(), measurement=Measurement(missing={"theta": 0.1})
            ),
            "theta",
        ),
        (
            lambda: fly(
                rigid().with_values({"Cm_alpha": 1e5}),
                MANEUVER,
                sample_times(1.0, 60.0),
                generator(),
                step=0.01,
            ),
            "diverges at",
        ),
        (lambda: fly(without_airspeed(), None, TIME, generator()), "diverges at"),
        (lambda: Measurement(missing={"q": 1.0}), "share of missing"),
        (lambda: Measurement(std={"q": -1.0}), "standard deviation"),
        (lambda: Measurement(correlation_time={"q": 0.0}), "correlation time"),
        (lambda: sample_times(0.0, 5.0), "sample times"),
        (lambda: sample_times(1.0, 0.2), "sample times"),
    ],
)
def test_bad_wishes_are_refused(fault, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        fault()
