"""A measured record: a rocket in free fall, 153 samples of barometric height quantised to 1 m."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command_line import CommandLine

RECORD = Path(__file__).parents[3] / "shared" / "flightdata" / "cavour_ballistic.csv"
pytestmark = pytest.mark.skipif(not RECORD.is_file(), reason="the measured records are not here")


def identified(flightid: CommandLine, folder: Path, start: float, method: str) -> dict[str, Any]:
    (folder / "vehicle.toml").write_text(
        "air_density_reference = 1.192\ndensity_scale_height = 8670\ngravity = "
        f"9.80\n[derivatives]\nbeta = {start}\n"
    )
    (folder / "map.toml").write_text('altitude = {column = "h", unit = "m"}\n')
    flightid.done(
        *(
            "identify",
            RECORD,
            "--model",
            "ballistic",
            "--vehicle",
            folder / "vehicle.toml",
            "--channels",
            folder / "map.toml",
        ),
        *("--from", 44, "--method", method, "--no-figures", "--out", folder / "out"),
    )
    content = json.loads((folder / "out" / "comparison.json").read_text())
    assert content["outcome"] == "converged" and list(content["parameters"]) == ["beta"]
    return content


@pytest.mark.sampled
@pytest.mark.parametrize("start", [250.0, 400.0])
@pytest.mark.parametrize("method", ["ekf", "ukf", "output-error"])
def test_ballistic_coefficient(
    flightid: CommandLine, tmp_path: Path, start: float, method: str
) -> None:
    beta = identified(flightid, tmp_path, start, method)["parameters"]["beta"]
    assert beta["unit"] == "kg/m2" and beta["std"] > 0
    assert abs(beta["estimate"] - 309.0) < 3.0


@pytest.mark.parametrize("start", [250.0, 400.0])
def test_equation_error_knows_how_little_it_knows(
    flightid: CommandLine, tmp_path: Path, start: float
) -> None:
    """Slopes of slopes of a height in steps of 1 m: a tenth of the information, and a sigma that
    says so.
    """
    beta = identified(flightid, tmp_path, start, "equation-error")["parameters"]["beta"]
    assert beta["std"] > 5.0
    assert abs(beta["estimate"] - 309.0) < 2.0 * beta["std"]


def test_the_residual_is_said_not_to_be_noise(flightid: CommandLine, tmp_path: Path) -> None:
    """The published value was fitted to the same record: its residual had a lag-1 correlation of
    0.84 and an rms of 1 m.
    """
    content = identified(flightid, tmp_path, 250.0, "output-error")
    assert not content["residual_tests"][0]["passed"]
    assert content["noise_std"]["altitude"] == pytest.approx(1.2, abs=0.3)
