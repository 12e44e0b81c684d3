"""`flightid identify` sets wild points aside, says so, and gives the values of the record without
them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.independent.short_period import BUSINESS_JET, Hidden
from tests.integration.command_line import CommandLine
from tests.jet_record import recorded, vehicle_file

HEADER = "time,elevator,alpha,q,nz"
WILD = ((90, 2, 0.2), (333, 3, -0.6), (500, 2, -0.3), (640, 4, 3.0))


def identified(flightid: CommandLine, record: Path, *options: str) -> tuple[str, dict[str, Any]]:
    folder = record.parent
    vehicle_file(folder / "v.toml", BUSINESS_JET)
    told = flightid.done(
        "identify",
        record,
        "--model",
        "rigid",
        "--vehicle",
        folder / "v.toml",
        "--no-figures",
        "--out",
        folder / "out",
        *options,
    )
    content: dict[str, Any] = json.loads((folder / "out" / "comparison.json").read_text())
    return " ".join(told.split()), content


@pytest.mark.long
def test_wild_points_are_set_aside(flightid: CommandLine, tmp_path: Path) -> None:
    clean, wild = recorded(tmp_path / "flight.csv", Hidden()), tmp_path / "wild.csv"
    expected = identified(flightid, clean)[1]
    rows = np.loadtxt(clean, delimiter=",", skiprows=1)
    for row, column, size in WILD:
        rows[row, column] += size
    np.savetxt(wild, rows, delimiter=",", header=HEADER, comments="", fmt="%.12g")
    told, found = identified(flightid, wild)
    assert (
        "alpha has 2 wild points" in told
        and "q has 1 wild point," in told
        and "nz has 1 wild point," in told
    )
    assert sum("wild point" in warning for warning in found["warnings"]) == 3
    for name, row in found["parameters"].items():
        assert (
            abs(row["estimate"] - expected["parameters"][name]["estimate"])
            < 0.2 * expected["parameters"][name]["std"]
        )
    written = np.genfromtxt(tmp_path / "out" / "record.csv", delimiter=",", skip_header=1)
    assert np.count_nonzero(np.isnan(written)) == len(WILD)


@pytest.mark.long
def test_a_residual_with_wild_points_is_not_called_noise(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """Taken as the record is, with ``--trust-record``."""
    path = recorded(tmp_path / "flight.csv", Hidden())
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    for row, column, size in WILD:
        rows[row, column] += size
    np.savetxt(path, rows, delimiter=",", header=HEADER, comments="", fmt="%.12g")
    told, content = identified(flightid, path, "--trust-record")
    assert "large in parts of the record: rms" in told and "consistent with noise in" not in told
    assert not any("wild point" in warning for warning in content["warnings"])


@pytest.mark.long
@pytest.mark.parametrize("channel", [2, 3])
def test_one_wild_point_at_an_edge_of_the_input_is_found_too(
    flightid: CommandLine, tmp_path: Path, channel: int
) -> None:
    path = recorded(tmp_path / "flight.csv", Hidden())
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[int(np.argmax(np.abs(np.diff(rows[:, 1])))) + 1, channel] += 0.5
    np.savetxt(path, rows, delimiter=",", header=HEADER, comments="", fmt="%.12g")
    told = identified(flightid, path)[0]
    assert "has 1 wild point," in told
