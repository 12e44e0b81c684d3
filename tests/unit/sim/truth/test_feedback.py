"""Flights under feedback, against the exact motion of a linear aircraft between samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.effects.input_path.actuator import ActuatorLag
from sim.errors import ModelError
from sim.maneuvers import step
from sim.truth.feedback import fly_with_feedback
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import linearise
from tests.bases import LEVEL, longitudinal_model
from tests.unstable_flight import FIGHTER, fighter

TIME = sample_times(25.0, 8.0)
GAINS = {"elevator": {"alpha": 0.9, "q": 0.6}}
PILOT = {"elevator": step(0.02, 1.0)}


def quiet() -> Model:
    return fighter().with_noise(Noise())


def seeded(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_without_noise_it_is_the_sampled_loop_of_the_linear_aircraft() -> None:
    """x[k+1] = F x[k] + G u[k] by the matrix exponential, u[k] = command + K x[k]; the elevator
    that is recorded is u.
    """
    record, truth = fly_with_feedback(quiet(), PILOT, GAINS, TIME, seeded())
    lin = linearise(quiet())
    block = expm(np.block([[lin.A, lin.B], [np.zeros((1, 3))]]) * 0.04)
    F, g, x = block[:2, :2], block[:2, 2], np.zeros(2)
    for k, t in enumerate(TIME):
        u = (0.02 if t > 1.0 - 1e-9 else 0.0) + 0.9 * x[0] + 0.6 * x[1]
        assert record["elevator"].values[k] == pytest.approx(u, abs=1e-9)
        np.testing.assert_allclose(
            [truth.states["alpha"][k], truth.states["q"][k]], x, rtol=0.0, atol=1e-8
        )
        x = F @ x + g * u
    assert max(np.linalg.eigvals(lin.A).real) > np.log(2.0) / 1.0, (
        "doubles in less than a second by itself"
    )
    assert np.max(np.abs(record["alpha"].values)) < 0.1


def test_without_gains_it_is_the_open_loop() -> None:
    record, _ = fly_with_feedback(quiet(), PILOT, {}, TIME[:51], seeded())
    other, _ = fly(quiet(), PILOT, TIME[:51], seeded(), step=0.005)
    for name in ("elevator", "alpha", "q", "nz"):
        np.testing.assert_allclose(record[name].values, other[name].values, rtol=1e-7, atol=1e-9)


def test_what_is_fed_back_is_what_is_recorded_noise_included() -> None:
    record, truth = fly_with_feedback(fighter(), PILOT, GAINS, TIME, seeded())
    command = np.where(TIME > 1.0 - 1e-9, 0.02, 0.0)
    np.testing.assert_allclose(
        record["elevator"].values,
        command + 0.9 * record["alpha"].values + 0.6 * record["q"].values,
        rtol=0.0,
        atol=1e-12,
    )
    noise = record["alpha"].values - truth.outputs["alpha"]
    assert np.std(noise) == pytest.approx(0.001, rel=0.2)
    again, _ = fly_with_feedback(fighter(), PILOT, GAINS, TIME, seeded())
    other, _ = fly_with_feedback(fighter(), PILOT, GAINS, TIME, seeded(2))
    assert all(np.array_equal(record[c.name].values, again[c.name].values) for c in record.channels)
    assert not np.array_equal(record["elevator"].values, other["elevator"].values)


def test_totals_are_fed_back_as_they_differ_from_the_start() -> None:
    model = longitudinal_model().with_noise(Noise())
    trim = {"elevator": step(LEVEL[1]), "thrust": step(LEVEL[2])}
    record, _ = fly_with_feedback(
        model, trim, {"elevator": {"theta": 0.5, "airspeed": 0.01}}, TIME, seeded()
    )
    np.testing.assert_allclose(record["elevator"].values, LEVEL[1], rtol=0.0, atol=1e-9)


@pytest.mark.long
def test_white_noise_forces_the_states_with_its_density() -> None:
    """Held hard in pitch, alpha is a first-order process: variance density / (2 L_alpha), the
    elevator's own part left to rounding.
    """
    model = fighter({**FIGHTER, "Cm_alpha": -0.3}).with_noise(Noise({}, {"alpha": 4e-6}))
    _, truth = fly_with_feedback(model, {}, {}, sample_times(25.0, 120.0), seeded())
    A = linearise(model).A
    from scipy.linalg import solve_continuous_lyapunov

    expected = solve_continuous_lyapunov(A, -np.diag([4e-6, 0.0]))
    assert np.var(truth.states["alpha"]) == pytest.approx(expected[0, 0], rel=0.4)
    assert truth.process_density == {"alpha": 4e-6}


def test_what_cannot_be_closed_is_refused() -> None:
    for gains, said in (
        ({"elevator": {"nz": 0.1}}, "moves 'nz' at once"),
        ({"elevator": {"theta": 0.1}}, "'theta' is not measured"),
        ({"rudder": {"q": 0.1}}, "no input 'rudder'"),
    ):
        with pytest.raises(ModelError, match=said):
            fly_with_feedback(quiet(), PILOT, gains, TIME, seeded())
    with pytest.raises(ModelError, match="under feedback"):
        fly_with_feedback(quiet().with_effects(ActuatorLag()), PILOT, GAINS, TIME, seeded())
    with pytest.raises(ModelError, match="drifts under feedback"):
        fly_with_feedback(
            fighter().with_noise(Noise({}, {"Cm_q": 1.0})), PILOT, GAINS, TIME, seeded()
        )
    with pytest.raises(ModelError, match="diverges at"):
        fly_with_feedback(
            quiet(), PILOT, {"elevator": {"alpha": -500.0}}, sample_times(25.0, 60.0), seeded()
        )
    still = longitudinal_model().with_noise(Noise())
    with pytest.raises(ModelError, match="diverges at 0 s"):  # rates over an airspeed that is none
        fly_with_feedback(
            still.with_initial(still.initial.with_values({"airspeed": 0.0})), {}, {}, TIME, seeded()
        )
    assert compile_model(quiet()).output_names == ("alpha", "q", "nz")
