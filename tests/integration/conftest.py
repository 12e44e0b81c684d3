"""What the tests of the command line share: the command itself, one rigid study, its vehicle
file.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from scenarios.studies.catalogue import load_scenario
from scenarios.studies.folder import write_study
from scenarios.studies.study import run_scenario
from tests.integration.command_line import VEHICLE, CommandLine


@pytest.fixture
def flightid(capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine(capsys)


@pytest.fixture(scope="session")
def rigid_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of `rigid`, figures included; tests only read it."""
    return write_study(
        run_scenario(load_scenario("rigid")), tmp_path_factory.mktemp("study") / "rigid"
    )


@pytest.fixture(scope="session")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The vehicle file of that record, its derivatives 10 to 30 % wrong."""
    path = tmp_path_factory.mktemp("vehicle") / "bomber.toml"
    path.write_text(VEHICLE)
    return path
