"""A length of the vehicle file that is several times too large or too small: the derivatives say so
in both directions.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.integration.command_line import CommandLine
from tests.whole_axes import flown, vehicle_text

# Model -> the scenario whose record and vehicle file are used (None: those of `tests.whole_axes`),
# a length that the moments contain, and by how much it is wrong: a flexible aircraft that is
# started with ten chords is unstable, and the fit does not leave its start.
AIRCRAFT = {
    "rigid": ("trace-nothing", "chord", 10.0),
    "flexible": ("trace-flexible", "chord", 4.0),
    "lateral": (None, "span", 10.0),
    "longitudinal": (None, "chord", 10.0),
}


@pytest.mark.long
@pytest.mark.parametrize("model", AIRCRAFT)
def test_a_wrong_length_is_cautioned_both_ways(
    flightid: CommandLine, tmp_path: Path, model: str
) -> None:
    scenario, length, times = AIRCRAFT[model]
    record, vehicle = tmp_path / "flight.csv", tmp_path / "flight_vehicle.toml"
    if scenario is not None:
        flightid("simulate", scenario, "--out", record)
    else:
        from scenarios.files.writing import write_record

        write_record(tmp_path, flown(model, 1), "flight")
        vehicle.write_text(vehicle_text(model))
    text = vehicle.read_text()
    said = {}
    for word, factor in (("right", 1.0), ("large", times), ("small", 1.0 / times)):
        known = re.search(rf"(?m)^{length} = (\S+)$", text)
        assert known is not None
        vehicle.write_text(text.replace(known[0], f"{length} = {float(known[1]) * factor!r}"))
        flightid.done(
            "identify",
            record,
            "--model",
            model,
            "--vehicle",
            vehicle,
            "--out",
            tmp_path / word,
            "--no-figures",
        )
        warnings = json.loads((tmp_path / word / "comparison.json").read_text())["warnings"]
        said[word] = " ".join(warning for warning in warnings if "implausible" in warning)
    assert said["right"] == ""
    assert "times smaller" in said["large"] and "times as large" not in said["large"]
    assert "times as large" in said["small"] and "times smaller" not in said["small"]
