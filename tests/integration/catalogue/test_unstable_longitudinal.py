"""An unstable longitudinal axis under feedback: identified by output error, and traced."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.identification.identify import identify
from scenarios.preparation.plan import Request
from scenarios.studies.estimating import vehicle_model
from sim.declaration.model import Model, Noise
from sim.maneuvers import Maneuver, Sum, doublet, step, three_two_one_one
from sim.record import Record
from sim.truth.feedback import fly_with_feedback
from sim.truth.flight import sample_times
from sim.vehicles.factory import linearise
from sim.vehicles.uncoupled import LONGITUDINAL_CONSTANTS

DEGREE = float(np.deg2rad(1.0))
SENSORS = {"airspeed": 0.2, "alpha": 0.002, "theta": 0.002, "q": 0.0026, "nz": 0.012, "nx": 0.004}
GAINS = {"elevator": {"alpha": 1.7, "q": 0.35}}
TRIM = step(1507.0)
MANEUVERS: dict[str, dict[str, Maneuver]] = {
    "train": {
        "elevator": Sum(
            (three_two_one_one(3.0 * DEGREE, 0.48, 1.0), doublet(-3.0 * DEGREE, 1.2, 5.28))
        ),
        "thrust": Sum((TRIM, doublet(400.0, 2.0, 4.0))),
    },
    "validate": {
        "elevator": Sum(
            (doublet(3.0 * DEGREE, 0.8, 1.0), three_two_one_one(-2.4 * DEGREE, 0.4, 4.8))
        ),
        "thrust": Sum((TRIM, doublet(-400.0, 2.0, 3.2))),
    },
}


def aircraft() -> Model:
    """The Navion with its centre of gravity aft."""
    return vehicle_model("navion_longitudinal", 0, Noise(SENSORS)).with_values({"Cm_alpha": 0.7})


def record(name: str, seed: int, duration: float = 8.0) -> Record:
    time = sample_times(25.0, duration)
    return fly_with_feedback(
        aircraft(), MANEUVERS[name], GAINS, time, np.random.default_rng(seed), step=0.005, name=name
    )[0]


def vehicle_file(folder: Path) -> Path:
    """Derivatives wrong by a fifth, up and down by turns."""
    parameters = aircraft().parameters
    free = [item for item in parameters if item.free]
    lines = [f"{name} = {parameters[name].value}" for name in LONGITUDINAL_CONSTANTS]
    lines += [
        "[derivatives]",
        *(f"{item.name} = {item.value * (1.0 + 0.2 * (-1.0) ** i)}" for i, item in enumerate(free)),
    ]
    path = folder / "vehicle.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def off(found: dict[str, tuple[float, float]]) -> list[float]:
    true = aircraft().parameters
    return [(value - true[name].value) / std for name, (value, std) in found.items()]


def test_it_doubles_in_about_a_second() -> None:
    roots = np.linalg.eigvals(
        linearise(aircraft(), about={"airspeed": 53.6448, "thrust": 1506.6}).A
    )
    assert 0.5 < np.log(2.0) / max(roots.real) < 1.2


@pytest.mark.slow
def test_output_error_finds_it_with_sigmas_that_hold() -> None:
    """Eight records, ten derivatives: the share within two sigmas, and none far off."""
    scores = []
    with tempfile.TemporaryDirectory() as folder:
        vehicle = read_vehicle(vehicle_file(Path(folder)), "longitudinal")
        for seed in range(8):
            found = identify(record("train", seed, 10.0), vehicle, "output-error")
            assert found.estimate.outcome.code == "converged"
            scores += off(
                {
                    row.name: (row.estimate, row.std)
                    for row in found.rows
                    if row.name in vehicle.derivatives
                }
            )
    assert len(scores) == 80
    assert np.mean(np.abs(scores) < 2.0) > 0.85 and np.max(np.abs(scores)) < 4.5


def traced(seed: int) -> Tracing:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        vehicle = vehicle_file(folder)
        for stem, draw in (("train", seed), ("validate", seed + 100)):
            write_record(folder, record(stem, draw), stem)
        return diagnose_files(
            Request((folder / "train.csv",), "longitudinal", vehicle, (folder / "validate.csv",))
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_where_nothing_is_hidden_the_loop_says_so(seed: int) -> None:
    diagnosis = traced(seed).diagnosis
    assert diagnosis.verdict.value == "consistent"
    scores = off({name: (found.value, found.std) for name, found in diagnosis.after.items()})
    assert np.max(np.abs(scores)) < 4.0
