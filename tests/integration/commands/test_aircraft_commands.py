"""Commands on a record of six degrees of freedom with a vehicle file of model aircraft."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import flightid as fid
from scenarios.files.aircraft_files import vehicle_file_text
from scenarios.files.writing import write_record
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import aircraft_model
from tests.airliner import AIRLINER
from tests.bases import AIRLINER_NOISE, airliner_flight, fly_model
from tests.integration.command_line import CommandLine


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of 8 s and its vehicle file."""
    made = tmp_path_factory.mktemp("aircraft")
    flight, model = airliner_flight(8.0), aircraft_model(AIRLINER).with_noise(AIRLINER_NOISE)
    rng = np.random.default_rng(4)
    outputs = tuple(
        Channel.of(signal.name, signal.unit, row + std * rng.standard_normal(len(row)))
        for signal, row in zip(model.equations.outputs, fly_model(model, flight), strict=True)
        for std in (0.3 * model.noise.measurement_std[signal.name],)
    )
    inputs = tuple(
        Channel.of(signal.name, signal.unit, row)
        for signal, row in zip(model.equations.inputs, flight.u, strict=True)
    )
    write_record(made, Record(flight.time, inputs, outputs, Hold.PREVIOUS, "flight"), "flight")
    (made / "plane.toml").write_text(vehicle_file_text(AIRLINER))
    return made


@pytest.mark.long
def test_identify_export_and_check(flightid: CommandLine, folder: Path) -> None:
    record, vehicle = folder / "flight.csv", folder / "plane.toml"
    flightid.done(
        "identify", record, "--model", "aircraft", "--vehicle", vehicle, "--no-figures",
        "--out", folder / "fit",
    )  # fmt: skip
    content = json.loads((folder / "fit" / "comparison.json").read_text())
    assert content["outcome"] == "converged"
    found = content["parameters"]
    for name, value in {"Cm_alpha": -1.0, "Cl_p": -0.5, "Cn_beta": 0.13}.items():
        assert abs(found[name]["estimate"] - value) < 4.0 * found[name]["std"]
    flightid.done("export", folder / "fit", "--to", "python", "--out", folder / "plane.py")
    assert "def derivatives" in (folder / "plane.py").read_text()
    flightid.done(
        "predict", folder / "fit", record, "--tolerances", "short-period,roll-response",
        "--out", folder / "band",
    )  # fmt: skip
    judged = json.loads((folder / "band" / "prediction.json").read_text())["tolerances"]
    assert [each["passed"] for each in judged] == [True, True]
    assert (folder / "band" / "tolerances_short-period.png").is_file()
    assert "short-period" in flightid.refused(
        "predict", folder / "fit", record, "--tolerances", "short"
    )
    told = flightid.done("check", record, "--vehicle", vehicle, "--no-figures")
    assert "alpha" in told


@pytest.mark.long
@pytest.mark.parametrize("axes", ["earth", "body"])
def test_derivatives_come_back_from_a_flight_in_recorded_wind(tmp_path: Path, axes: str) -> None:
    further = ("psi",) if axes == "earth" else ()
    windy, flight = replace(AIRLINER, wind=axes, further=further), airliner_flight(8.0)
    t, rng = flight.time, np.random.default_rng(3)
    wind = [8.0 + 1.5 * np.sin(0.9 * t), -5.0 + 1.5 * np.sin(1.3 * t), np.sin(2.1 * t)]
    model, u = aircraft_model(windy), np.vstack([flight.u, wind])
    spread = {"psi": 0.002, **AIRLINER_NOISE.measurement_std}
    columns = {"time": t, **{e.name: row for e, row in zip(model.equations.inputs, u, strict=True)}}
    rows = fly_model(model, replace(flight, u=u))
    for signal, row in zip(model.equations.outputs, rows, strict=True):
        noise = 0.3 * spread[signal.name] * rng.standard_normal(len(row))
        columns[signal.name] = row + noise
    (tmp_path / "plane.toml").write_text(vehicle_file_text(windy))
    found = fid.identify(pd.DataFrame(columns), "aircraft", tmp_path / "plane.toml")
    for name, value in {"CL_alpha": 5.2, "Cm_q": -20.0, "Cl_p": -0.5, "Cn_beta": 0.13}.items():
        assert abs(found[name].value - value) < 4.0 * found[name].sigma


def test_a_model_of_its_own_kind_is_listed(flightid: CommandLine) -> None:
    told = flightid.done("models", "aircraft")
    assert "six degrees of freedom" in told and "Cm_alpha" in told


def test_help_of_export_names_the_targets_of_model_aircraft(flightid: CommandLine) -> None:
    text = " ".join(flightid.done("export", "--help").split())
    assert "jsbsim and dave-ml take only the model aircraft" in text
    assert "the last two for the model aircraft only" in text
