"""Columns beyond all measure and models that do not fit: no warning of NumPy reaches the terminal,
what overflows is left out and counted.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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


def diagnosed(
    flightid: CommandLine, model: str, record: Path, vehicle: Path, out: Path
) -> tuple[str, dict[str, Any]]:
    """A diagnosis in which every warning is an error, so that none can reach a terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        told = flightid.done(
            "diagnose",
            record,
            "--model",
            model,
            "--vehicle",
            vehicle,
            "--trust-record",
            "--no-figures",
            "--out",
            out,
        )
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    return told, content


@pytest.fixture
def table(tmp_path: Path) -> np.ndarray:
    """Time, elevator, alpha, q, nz of a jet, 25 samples a second."""
    return np.loadtxt(recorded(tmp_path / "flight.csv", Hidden()), delimiter=",", skiprows=1)[:220]


def written(path: Path, table: np.ndarray, control: str = "elevator") -> Path:
    np.savetxt(
        path, table, delimiter=",", header=f"time,{control},alpha,q,nz", comments="", fmt="%.10g"
    )
    return path


def refused(flightid: CommandLine, model: str, record: Path, vehicle: Path, out: Path) -> str:
    """The one line of a diagnosis whose declared model cannot be fitted; nothing is written."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        call = flightid(
            "diagnose",
            record,
            "--model",
            model,
            "--vehicle",
            vehicle,
            "--trust-record",
            "--no-figures",
            "--out",
            out,
        )
    assert (call.code, call.out, call.err.count("\n")) == (2, "", 1)
    assert not out.exists()
    return call.err


@pytest.mark.parametrize(
    ("column", "said"),
    [(1, "the fit of the declared model has failed"), (3, "is no measurement")],
    ids=["elevator", "q"],
)
def test_a_column_of_1e30(
    flightid: CommandLine, table: np.ndarray, tmp_path: Path, column: int, said: str
) -> None:
    """Nothing is built on a fit that has failed, nor on rates that nothing can have."""
    table[:, column] *= 1e30
    vehicle = vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    assert said in refused(
        flightid, "rigid", written(tmp_path / "huge.csv", table), vehicle, tmp_path / "out"
    )


@pytest.mark.long
def test_a_low_order_model_of_an_aircraft_that_it_does_not_fit(
    flightid: CommandLine, table: np.ndarray, tmp_path: Path
) -> None:
    (tmp_path / "loes.toml").write_text(LOES)
    said = refused(
        flightid,
        "loes",
        written(tmp_path / "stick.csv", table, "stick"),
        tmp_path / "loes.toml",
        tmp_path / "out",
    )
    assert "the free simulation diverges" in said and "filter-error" in said


@pytest.mark.long
def test_a_sound_record_overflows_nowhere(
    flightid: CommandLine, table: np.ndarray, tmp_path: Path
) -> None:
    vehicle = vehicle_file(tmp_path / "v.toml", BUSINESS_JET)
    told, content = diagnosed(
        flightid, "rigid", written(tmp_path / "sound.csv", table), vehicle, tmp_path / "out"
    )
    assert "overflows" not in content and "range of numbers" not in told
