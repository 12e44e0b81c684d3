"""`flightid identify --method ekf --engine`: the same result by either engine, one line that names
it, and refused for other methods.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scenarios.files.writing import write_record
from tests import loes_problem as problem
from tests.bases import LOES_CONSTANTS, LOES_VALUES
from tests.integration.command_line import CommandLine

LINES = {
    "batched": "engine: batched kernel; equals filterpy to ",
    "filterpy": "engine: filterpy ExtendedKalmanFilter",
}
VEHICLE = "name = 'low order'\n{constants}\n[derivatives]\n{derivatives}\n"


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    write_record(tmp_path, problem.record(4, duration=1.8), "flight")
    derivatives = {
        name: (1.1 if name != "delay" else 1.0) * value for name, value in LOES_VALUES.items()
    } | {"delay": 0.1}
    told = {"constants": LOES_CONSTANTS, "derivatives": derivatives}
    text = VEHICLE.format(
        **{
            key: "\n".join(f"{name} = {value!r}" for name, value in table.items())
            for key, table in told.items()
        }
    )
    (tmp_path / "low_order.toml").write_text(text, encoding="utf-8")
    return tmp_path / "flight.csv", tmp_path / "low_order.toml"


def test_filterpy_finds_what_the_batched_bank_finds(
    flightid: CommandLine, files: tuple[Path, Path], tmp_path: Path
) -> None:
    found = {}
    for engine in ("batched", "filterpy"):
        out = tmp_path / engine
        common = ("--model", "loes", "--vehicle", files[1], "--method", "ekf", "--no-figures")
        printed = flightid.done("identify", files[0], *common, "--engine", engine, "--out", out)
        assert printed.count("engine: ") == 1 and LINES[engine] in printed
        found[engine] = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
        assert found[engine]["engine"]["name"] == engine
    rows, others = (found[engine]["parameters"] for engine in ("batched", "filterpy"))
    assert set(rows) == set(others)
    for name, row in rows.items():
        assert others[name]["estimate"] == pytest.approx(row["estimate"], abs=1e-4 * row["std"]), (
            name
        )
        assert others[name]["std"] == pytest.approx(row["std"], rel=1e-4), name


def test_an_engine_is_refused_where_there_is_no_choice(
    flightid: CommandLine, files: tuple[Path, Path]
) -> None:
    common = ("identify", files[0], "--model", "loes", "--vehicle", files[1])
    assert (
        "only the extended Kalman filter has two engines, and the method is output-error"
        in flightid.refused(*common, "--engine", "filterpy")
    )
    assert "use one of filterpy, batched" in flightid.refused(
        *common, "--method", "ekf", "--engine", "numba"
    )
