"""Structure of an F-16 whose truth is tables: terms found, a maneuver predicted, a term missing."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.aircraft_files import read_aircraft
from scenarios.files.declarations import read_toml_source
from scenarios.structure.report import findings
from scenarios.structure.study import StructureOptions, predicted_r2, structure_of
from sim.record import Record
from sim.vehicles.aircraft import Aircraft
from tests.oracles import f16_tables as tables

START = {"airspeed": 152.4, "alpha": 0.0465, "elevator": -0.0301}
NOISE = {
    "airspeed": 0.1,
    **dict.fromkeys(("alpha", "beta"), 0.05 * tables.DEGREE),
    **dict.fromkeys(("p", "q", "r"), 0.02 * tables.DEGREE),
    **dict.fromkeys(("ax", "ay", "az"), 0.02),
}


@cache
def f16() -> Aircraft:
    place = files("scenarios").joinpath("catalog", "aircraft", "f16.toml")
    with as_file(place) as path:
        return read_aircraft(read_toml_source(path))[0]


@cache
def flight(seed: int) -> Record:
    """24 seconds of sums of sines on all surfaces, with slow changes of alpha."""
    rng = np.random.default_rng(seed)
    frequency = np.array([0.11, 0.23, 0.41, 0.67, 0.93, 1.3]) * rng.uniform(0.85, 1.15, (3, 6))
    phase = rng.uniform(0.0, 2.0 * math.pi, (3, 6))
    size = np.array([3.5, 3.0, 4.0])[:, None] * tables.DEGREE / np.sqrt(3.0)

    def commands(t: float) -> tuple[float, float, float, float]:
        begun = min(t / 2.0, 1.0)
        moved = begun * np.sum(size * np.sin(2.0 * math.pi * frequency * t + phase), axis=1)
        slow = -0.06 * begun * math.sin(2.0 * math.pi * t / 15.0)
        return float(moved[0]) + slow, float(moved[1]), float(moved[2]), 12e3

    # Sensors stand at the centre of gravity, which is the reference point.
    return tables.fly(commands, START, 24.0, f"m{seed}", noise=NOISE, seed=seed)


def at_reference() -> Aircraft:
    """The F-16 with its sensors at the reference point."""
    return replace(f16(), sensors={})


def test_the_tables_give_the_angular_accelerations_of_the_books_check_case() -> None:
    # Stevens and Lewis, section 3.5: state and control of their model test case, c.g. 0.4 chord.
    speed, alpha, beta = 500.0 * tables.FOOT, 0.5, -0.2
    flow = np.array(
        [math.cos(alpha) * math.cos(beta), math.sin(beta), math.sin(alpha) * math.cos(beta)]
    )
    x = np.concatenate([speed * flow, [0.7, -0.8, 0.9, -1.0, 1.0]])
    density = 2.377e-3 * (1.0 - 0.703e-5 * 1e4) ** 4.14 * 515.378818
    force, moment = tables.loads(x, (0.349066, -0.261799, -0.349066), density)
    moment = moment + (0.35 - 0.4) * tables.CHORD * np.array([0.0, force[2], -force[1]])
    found = tables.turning(x[3:6], moment, tables.SPIN)
    assert found == pytest.approx([12.62679, 0.9649671, 0.5809759], rel=3e-3)


def test_the_polynomials_of_the_vehicle_file_describe_the_tables() -> None:
    terms = f16().coefficients
    rng = np.random.default_rng(1)
    low = np.radians([-5.0, -10.0, -15.0, -15.0, -20.0])
    high = np.radians([20.0, 10.0, 15.0, 15.0, 20.0])
    points = rng.uniform(low, high, (400, 5))
    rates = rng.uniform(-0.02, 0.02, (400, 3))
    true = [
        tables.coefficients(a, b, de, da, dr, rates=tuple(rate.tolist()))
        for (a, b, de, da, dr), rate in zip(points.tolist(), rates, strict=True)
    ]
    names = ("alpha", "beta", "elevator", "aileron", "rudder")
    signals = dict(zip(names, points.T, strict=True)) | dict(zip("pqr", rates.T, strict=True))
    for axis in tables.coefficients(0.0, 0.0, 0.0, 0.0, 0.0):
        wanted = np.array([each[axis] for each in true])
        told = sum(value * term.of(signals) for term, value in terms[axis].items())
        error = float(np.sum((wanted - told) ** 2) / np.sum((wanted - wanted.mean()) ** 2))
        assert error < 0.05, axis


def test_three_maneuvers_predict_a_fourth() -> None:
    fitted = [flight(seed) for seed in (1, 2, 3)]
    found = structure_of(fitted, at_reference(), StructureOptions(degree=3))
    (told,) = predicted_r2(found, [flight(4)]).values()
    assert min(told.values()) > 0.97, told


def test_splines_in_alpha_are_offered_and_told_with_their_collinearity() -> None:
    found = structure_of([flight(1)], at_reference(), StructureOptions(degree=1, splines=3))
    (told,) = predicted_r2(found, [flight(4)]).values()
    assert min(told.values()) > 0.9, told
    assert any(line.startswith("CX: condition index") for line in findings(found))


def test_a_coefficient_that_lacks_a_term_is_named(tmp_path: Path) -> None:
    path = tmp_path / "terms.toml"
    common = [
        "alpha",
        "beta",
        "p",
        "q",
        "r",
        "aileron",
        "rudder",
        "alpha^2",
        "beta^2",
        "alpha*beta",
    ]
    offered = {axis: [*common, "elevator", "alpha^3"] for axis in ("CX", "CY", "CZ", "Cl", "Cn")}
    offered |= {"Cm": [*common, "alpha*elevator", "elevator^2"]}
    path.write_text("".join(f"{axis} = {terms!r}\n" for axis, terms in offered.items()))
    fitted = [flight(seed) for seed in (1, 2, 3)]
    found = structure_of(fitted, at_reference(), StructureOptions(terms=path))
    (line,) = [each for each in findings(found) if each.startswith("Cm lacks")]
    assert "elevator" in line
