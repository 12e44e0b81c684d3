"""The flights by which sigmas are judged: they agree with the project's equations, of which they
use none, and their noise is what they say.
"""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest

from exam.coverage import independent_flights as flights
from exam.coverage.independent_flights import (
    CONSTANTS,
    MODELS,
    NOISES,
    SENSORS,
    TRUE,
    ar1,
    dryden,
    flown,
    level,
    maneuver,
    markov,
    motion,
)
from sim.declaration.compile import compile_model
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Hold
from sim.vehicles.factory import model_from_constants


def test_nothing_of_the_project_is_used() -> None:
    tree = ast.parse(Path(flights.__file__).read_text(encoding="utf-8"))
    used = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    used |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in used} <= {
        "__future__",
        "collections",
        "dataclasses",
        "functools",
        "math",
        "numpy",
    }


@pytest.mark.sampled
@pytest.mark.parametrize("model", MODELS)
def test_calm_flights_are_those_of_the_equations_under_test(model: str) -> None:
    time, inputs = maneuver(model)
    start = {}
    if model == "longitudinal":
        alpha, _, _ = level()
        start = {"airspeed": CONSTANTS[model]["reference_airspeed"], "alpha": alpha, "theta": alpha}
    system = compile_model(
        model_from_constants(model, CONSTANTS[model], TRUE[model], initial=start)
    )
    grid, p = make_grid(time, 0.005), system.parameters.values()
    drive = drive_from_record(
        system,
        p,
        np.array([inputs[name] for name in system.input_names]),
        time,
        Hold.PREVIOUS,
        grid,
    )
    theirs = dict(
        zip(
            system.output_names,
            simulate(system, p.tolist(), system.initial.values().tolist(), drive, grid),
            strict=True,
        )
    )
    ours = motion(model, time, inputs)
    for name in SENSORS[model]:
        assert np.std(ours[name]) > 2.0 * SENSORS[model][name], (
            f"{name} moves by less than its noise"
        )
        np.testing.assert_allclose(
            ours[name], theirs[name], atol=1e-6 * np.max(np.abs(ours[name])), err_msg=name
        )


@pytest.mark.long
def test_a_flight_is_the_same_again_and_another_run_is_not() -> None:
    for noise in NOISES:
        one, again, other = (
            flown("rigid", noise, 3),
            flown("rigid", noise, 3),
            flown("rigid", noise, 4),
        )
        assert one.start == again.start and one.start != other.start
        for name, column in one.columns.items():
            np.testing.assert_array_equal(column, again.columns[name])
        assert np.any(one.columns["q [rad/s]"] != other.columns["q [rad/s]"])
        for name, value in one.true.items():
            assert 0.7 <= one.start[name] / value <= 1.3


def test_gusts_move_the_aircraft_and_not_only_its_vane() -> None:
    time, inputs = maneuver("rigid")
    calm = motion("rigid", time, inputs)
    rough = motion("rigid", time, inputs, np.full((len(time) - 1) * flights.FINE + 1, 1.0))
    V = CONSTANTS["rigid"]["airspeed"]
    # A steady updraught is at first all angle of attack; then the aircraft rises with it.
    assert rough["alpha"][0] - calm["alpha"][0] == pytest.approx(1.0 / V)
    assert rough["nz"][0] > calm["nz"][0]
    assert (
        abs(rough["alpha"][-1] - calm["alpha"][-1]) < 0.02 / V
        and abs(rough["nz"][-1] - calm["nz"][-1]) < 0.01
    )


def test_noise_has_the_autocovariance_of_its_name() -> None:
    rng, V, T = np.random.default_rng(1), 50.0, flights.GUST_LENGTH / 50.0
    step, many = 0.1, 60_000

    def autocovariance(row: np.ndarray, lag: int) -> float:
        return float(np.mean(row[lag:] * row[: len(row) - lag]))

    slow = ar1(rng, many)
    assert [autocovariance(slow, lag) for lag in (0, 1, 5)] == pytest.approx(
        [1.0, 0.9, 0.9**5], abs=0.05
    )
    gust = markov(rng, many, step, V)
    assert [autocovariance(gust, lag) for lag in (0, 15, 30)] == pytest.approx(
        [math.exp(-lag * step / T) for lag in (0, 15, 30)], abs=0.12
    )
    gust = dryden(rng, many, step, V)
    # The inverse transform of Dryden's vertical spectrum: (1 - t/2T) exp(-t/T).
    expected = [
        (1.0 - lag * step / (2.0 * T)) * math.exp(-lag * step / T) for lag in (0, 15, 30, 60)
    ]
    assert [autocovariance(gust, lag) for lag in (0, 15, 30, 60)] == pytest.approx(
        expected, abs=0.08
    )
