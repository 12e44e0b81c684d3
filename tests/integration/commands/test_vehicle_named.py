"""What `predict` and `response` say of the vehicle file whose numbers they use."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from tests.integration.command_line import CommandLine


@pytest.fixture
def flight(flightid: CommandLine, tmp_path: Path) -> Path:
    """A folder with a short flight, its vehicle file and the study of its identification."""
    folder = tmp_path / "named"
    folder.mkdir()
    short = ("--set", "flight.train.duration=8 s", "--set", "flight.validate.duration=6 s")
    flightid.done("simulate", "trace-nothing", *short, "--out", folder / "f.csv")
    (folder / "f_vehicle.toml").rename(folder / "mine.toml")
    model = ("--model", "rigid", "--vehicle", folder / "mine.toml")
    flightid.done("identify", folder / "f.csv", *model, "--no-figures", "--out", folder / "study")
    return folder


def vehicle_on_page(folder: Path) -> list[str]:
    """Hashes of the vehicle files that a page lists under its inputs."""
    page = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    inputs = page["reproduction"]["inputs"]
    return [sha for use, _, sha in inputs if use == "vehicle"]


def hash_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_prediction_names_the_file_of_its_study(
    flightid: CommandLine, flight: Path, tmp_path: Path
) -> None:
    record, out = flight / "f_validate.csv", tmp_path / "out"
    said = flightid.done("predict", flight / "study", record, "--no-figures", "--out", out)
    assert "rigid model of bomber_rigid (mine.toml), from identify" in " ".join(said.split())
    assert vehicle_on_page(out) == [hash_of(flight / "mine.toml")]


def test_a_model_fitted_to_responses_names_its_file(
    flightid: CommandLine, flight: Path, tmp_path: Path
) -> None:
    words = ["response", flight / "f.csv", "--input", "elevator", "--output", "q", "--no-figures"]
    model = ("--model", "rigid", "--vehicle", flight / "mine.toml")
    for number, (more, vehicles) in enumerate((((), []), (model, [hash_of(flight / "mine.toml")]))):
        out = tmp_path / str(number)
        said = " ".join(flightid.done(*words, *more, "--out", out).split())
        line = "rigid model of bomber_rigid (mine.toml), linearised about rest"
        assert (line in said) == bool(more)
        assert vehicle_on_page(out) == vehicles
