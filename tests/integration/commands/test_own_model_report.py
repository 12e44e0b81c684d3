"""The rigid short period as a user's own file beside the built-in one: the same numbers and the
same report, the name apart.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from scenarios.files.user_models import is_of_aircraft, read_user_model
from tests.integration.command_line import CommandLine
from tests.own_models import ROLL, SHORT_PERIOD, model_file

OWN, BUILT_IN = "short period model", "rigid model"
NOT_ALIKE = {"created", "model", "model_sha256"}  # when it was made, and what the model is called


def alike(text: str) -> str:
    """A report without its name, its folder and its time."""
    model = r'--model(?:</span> <span class="word">| )[^\s<]+'
    return re.sub(
        rf"seconds: .*|written to .*|below; in .*|{model}|\d{{4}}-\d\d-\d\d[T ][\d:]+Z?",
        "",
        text.replace(OWN, BUILT_IN),
    )


def common(content: Any) -> Any:
    """JSON without what differs by nature."""
    if isinstance(content, dict):
        return {key: common(value) for key, value in content.items() if key not in NOT_ALIKE}
    return [common(value) for value in content] if isinstance(content, list) else content


@pytest.mark.long
@pytest.mark.parametrize(
    "scenario", ["trace-nothing", pytest.param("trace-delay", marks=pytest.mark.slow)]
)
def test_numbers_and_reports_are_the_same(
    flightid: CommandLine, tmp_path: Path, scenario: str
) -> None:
    changes = (
        "--set",
        "flight.rate=20 Hz",
        "--set",
        "flight.step=5 ms",
        "--set",
        "flight.train.duration=12 s",
    )
    flightid.done("simulate", scenario, "--out", tmp_path / "flight.csv", *changes)
    told, identified, folders = {}, {}, {name: tmp_path / name for name in ("rigid", "own")}
    for name, model in (("rigid", "rigid"), ("own", model_file(tmp_path, SHORT_PERIOD))):
        asked = (
            tmp_path / "flight.csv",
            "--model",
            model,
            "--vehicle",
            tmp_path / "flight_vehicle.toml",
        )
        validate = ("--validate", tmp_path / "flight_validate.csv")
        told[name] = flightid.done(
            "diagnose", *asked, *validate, "--out", folders[name], "--no-figures"
        )
        identified[name] = flightid.done("identify", *asked)
    for printed in (told, identified):
        assert OWN in printed["own"] and alike(printed["own"]) == alike(printed["rigid"])
    hidden = scenario == "trace-delay"
    assert ("TRACED" in told["own"]) == hidden and re.search(
        "(angle-of-attack|pitch-rate|load-factor) error", told["own"]
    )
    assert hidden <= ("kinematics alone" in told["own"]), (
        "an aircraft's own model is asked for its kinematics"
    )
    found, expected = (
        json.loads((folder / "diagnosis.json").read_text())
        for folder in (folders["own"], folders["rigid"])
    )
    assert (
        found["verdict"] == ("traced" if hidden else "consistent")
        and found["inputs"]["model"] == "my_model.py"
    )
    # The same operations run in the same order: equal to the last digit, and so to 1e-9.
    assert common(found) == common(expected)
    pages = [alike((folder / "report.html").read_text()) for folder in folders.values()]
    assert pages[0] == pages[1]
    for name in ("evidence.csv", "residuals.csv", "validate_prediction.csv"):
        assert (folders["own"] / name).read_bytes() == (folders["rigid"] / name).read_bytes()


def test_what_speaks_of_an_aircraft(tmp_path: Path) -> None:
    whole = read_user_model(model_file(tmp_path, SHORT_PERIOD)).model
    assert is_of_aircraft(whole) and not is_of_aircraft(
        read_user_model(model_file(tmp_path, ROLL)).model
    )
    # A charge q in coulomb, or a speed that is none of the air, is another matter.
    belt = SHORT_PERIOD.replace("airspeed", "belt_speed").replace(
        "belt_speed_change", "speed_change"
    )
    charge = SHORT_PERIOD.replace('"q": "rad/s"', '"q": "C"')
    assert not any(
        is_of_aircraft(read_user_model(model_file(tmp_path, text)).model) for text in (belt, charge)
    )
