"""diagnose, identify and check look at the raw columns first: what they refuse, set aside, warn of
and write, as one runs them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.record import Record
from tests.integration.command_line import CommandLine
from tests.recorded_flight import Aircraft, altered, exchanged, flight

AIRCRAFT = Aircraft()
PRESSURE_AREA = 0.5 * 1.0 * AIRCRAFT.airspeed**2 * 16.0
VEHICLE = f"""
name = "trainer"
mass = 1500.0
wing_area = 16.0
chord = 1.5
pitch_inertia = 2500.0
airspeed = {AIRCRAFT.airspeed}
air_density = 1.0
[derivatives]
CL_alpha = {0.85 * AIRCRAFT.lift * 1500.0 * AIRCRAFT.airspeed / PRESSURE_AREA}
CL_q = 3.0
CL_de = 0.1
Cm_alpha = {0.85 * AIRCRAFT.stiffness * 2500.0 / (PRESSURE_AREA * 1.5)}
Cm_q = -6.0
Cm_de = {1.1 * AIRCRAFT.power * 2500.0 / (PRESSURE_AREA * 1.5)}
"""
# diagnose is dearer: refused as they are, and run once below
COMMANDS = {"identify": "comparison.json", "check": "compatibility.json"}


def written(folder: Path, record: Record) -> Path:
    """A record as a CSV file, the vehicle file beside it."""
    columns = {
        "time": record.time,
        **{channel.name: channel.with_gaps() for channel in record.channels},
    }
    lines = [
        ",".join(columns),
        *(
            ",".join("" if np.isnan(cell) else repr(float(cell)) for cell in row)
            for row in zip(*columns.values(), strict=True)
        ),
    ]
    (folder / "flight.csv").write_text("\n".join(lines) + "\n")
    (folder / "vehicle.toml").write_text(VEHICLE)
    return folder / "flight.csv"


@pytest.fixture(scope="module")
def sound() -> Record:
    return flight(np.random.default_rng(41), AIRCRAFT, duration=12.0)


def arguments(command: str, path: Path) -> list[object]:
    model = [] if command == "check" else ["--model", "rigid"]
    return [command, path, *model, "--vehicle", path.parent / "vehicle.toml"]


REFUSED: dict[str, tuple[Callable[[Record], Record], str]] = {
    "elevator turned": (
        lambda r: altered(r, elevator=np.negative),
        "channel elevator: has the sign turned",
    ),
    "exchanged": (lambda r: exchanged(r, "alpha", "q"), "channels alpha and q: are exchanged"),
    "degrees": (lambda r: altered(r, q=np.degrees), "channel q: is in deg/s"),
    "nz in m/s2": (lambda r: altered(r, nz=lambda v: 9.80665 * v), "channel nz: is in m/s2"),
    "milliseconds": (lambda r: altered(r, time=lambda t: 1000.0 * t), "channel time: is in ms"),
}


@pytest.mark.sampled
@pytest.mark.parametrize("fault", REFUSED)
@pytest.mark.parametrize("command", ["diagnose", "identify", "check"])
def test_what_is_certain_is_refused_with_its_remedy(
    command: str, fault: str, sound: Record, tmp_path: Path, flightid: CommandLine
) -> None:
    spoil, said = REFUSED[fault]
    told = flightid.refused(*arguments(command, written(tmp_path, spoil(sound))))
    assert told.startswith(f"flight.csv, {said}") and "--trust-record" in told


@pytest.mark.sampled
@pytest.mark.parametrize("command", COMMANDS)
def test_held_samples_are_set_aside_and_said(
    command: str, sound: Record, tmp_path: Path, flightid: CommandLine
) -> None:
    held = altered(sound, alpha=lambda v: v[4 * (np.arange(len(v)) // 4)])
    out = flightid.done(
        *arguments(command, written(tmp_path, held)), "--out", tmp_path / "study", "--no-figures"
    )
    assert "record: flight.csv: alpha is updated every 4 samples" in out
    content = json.loads((tmp_path / "study" / COMMANDS[command]).read_text())
    assert any("alpha is updated every 4 samples" in warning for warning in content["warnings"])
    record = content["record"]
    assert record["masked"] == {"flight.csv": {"alpha": 450}}
    assert [(one["kind"], one["certainty"]) for one in record["findings"]] == [
        ("held", "costs information")
    ]


@pytest.mark.sampled
@pytest.mark.parametrize("command", COMMANDS)
def test_a_trusted_record_is_only_warned_of(
    command: str, sound: Record, tmp_path: Path, flightid: CommandLine
) -> None:
    path = written(tmp_path, altered(sound, elevator=np.negative))
    out = flightid.done(
        *arguments(command, path), "--trust-record", "--out", tmp_path / "study", "--no-figures"
    )
    assert "warning: flight.csv: elevator has the sign turned" in out
    content = json.loads((tmp_path / "study" / COMMANDS[command]).read_text())
    assert content["record"]["trusted"] is True and content["record"]["masked"] == {}
    assert any("elevator has the sign turned" in warning for warning in content["warnings"])


@pytest.mark.long
def test_a_diagnosis_says_what_it_saw_in_print_in_json_and_on_its_page(
    sound: Record, tmp_path: Path, flightid: CommandLine
) -> None:
    def stuck(values: np.ndarray) -> np.ndarray:
        return np.where(
            (np.arange(len(values)) > 150) & (np.arange(len(values)) < 190), values[150], values
        )

    out = flightid.done(
        *arguments("diagnose", written(tmp_path, altered(sound, q=stuck))),
        "--out",
        tmp_path / "study",
        "--no-figures",
    )
    assert "CONSISTENT" in out and "record: flight.csv: q is stuck from 3 to 3.78 s" in out
    content = json.loads((tmp_path / "study" / "diagnosis.json").read_text())
    assert content["record"]["masked"] == {"flight.csv": {"q": 39}}
    page = (tmp_path / "study" / "report.html").read_text()
    assert "The record as it was recorded" in page and "39 samples set aside" in page


def test_a_clean_record_has_nothing_to_tell(
    sound: Record, tmp_path: Path, flightid: CommandLine
) -> None:
    out = flightid.done(
        *arguments("identify", written(tmp_path, sound)),
        "--out",
        tmp_path / "study",
        "--no-figures",
    )
    assert "record:" not in out and "warning" not in out
    assert (
        json.loads((tmp_path / "study" / "comparison.json").read_text())["record"]["findings"] == []
    )
