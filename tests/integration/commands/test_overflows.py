"""Columns beyond all measure and models that do not fit: no warning of NumPy reaches the terminal, what overflows is left out and counted."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.diagnosis.overflows import overflow_sentence
from tests.independent.short_period import BUSINESS_JET, Hidden
from tests.integration.command_line import CommandLine
from tests.jet_record import recorded, vehicle_file

LOES = """
name = "jet"
airspeed = 206.0
gravity = 9.8
[derivatives]
L_alpha = 1.0
M_alpha = 4.0
L_delta = -0.01
M_delta = -5.0
L_q = 1.0
M_q = 1.5
inv_tau = 10.0
delay = 0.05
"""


def diagnosed(flightid: CommandLine, model: str, record: Path, vehicle: Path, out: Path) -> tuple[str, dict[str, Any]]:
    """A diagnosis in which every warning is an error, so that none can reach a terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        told = flightid.done("diagnose", record, "--model", model, "--vehicle", vehicle, "--trust-record", "--no-figures", "--out", out)
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    return told, content


@pytest.fixture
def table(tmp_path: Path) -> np.ndarray:
    """Time, elevator, alpha, q, nz of a jet, 25 samples a second."""
    return np.loadtxt(recorded(tmp_path / "flight.csv", Hidden()), delimiter=",", skiprows=1)[:220]


def written(path: Path, table: np.ndarray, control: str = "elevator") -> Path:
    np.savetxt(path, table, delimiter=",", header=f"time,{control},alpha,q,nz", comments="", fmt="%.10g")
    return path


@pytest.mark.parametrize("column", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_column_of_1e30(flightid: CommandLine, table: np.ndarray, tmp_path: Path, column: int) -> None:
    table[:, column] *= 1e30
    vehicle = vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    told, content = diagnosed(flightid, "rigid", written(tmp_path / "huge.csv", table), vehicle, tmp_path / "out")
    # With the control the way of the search, and whether it overflows at all, hang on how the processor adds up.
    counted = content.get("overflows", 0) if column == 1 else content["overflows"]
    assert (counted > 0 and overflow_sentence(counted) in content["warnings"]) or (column == 1 and counted == 0)
    assert " ".join(told.split()).count("left the range of numbers") == int(counted > 0)
    assert all(np.isfinite(row["value"]) for row in content["parameters"]["after"].values())


def test_a_low_order_model_of_an_aircraft_that_it_does_not_fit(flightid: CommandLine, table: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "loes.toml").write_text(LOES)
    told, content = diagnosed(flightid, "loes", written(tmp_path / "stick.csv", table, "stick"), tmp_path / "loes.toml", tmp_path / "out")
    assert "Warning" not in told and content["verdict"] in told.lower()


def test_a_sound_record_overflows_nowhere(flightid: CommandLine, table: np.ndarray, tmp_path: Path) -> None:
    vehicle = vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    told, content = diagnosed(flightid, "rigid", written(tmp_path / "sound.csv", table), vehicle, tmp_path / "out")
    assert "overflows" not in content and "range of numbers" not in told
