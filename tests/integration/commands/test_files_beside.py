"""Files that a command reads because they are beside the record: it names them, and a wrong number
in one is offered as a cause.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.integration.command_line import CommandLine

SAID = "also read, because found beside the records: "


@pytest.fixture
def folder(flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record of a flight without a flaw, its JSON, and the vehicle file as ``vehicle.toml``."""
    monkeypatch.chdir(tmp_path)
    flightid("simulate", "trace-nothing", "--out", "flight.csv")
    shutil.move("flight_vehicle.toml", "vehicle.toml")
    return tmp_path


def flat(text: str) -> str:
    return " ".join(text.split())


def test_each_command_names_what_it_found_beside_the_record(
    flightid: CommandLine, folder: Path
) -> None:
    both = f"note: {SAID}vehicle.toml, flight.json"
    calls = {
        "identify": (
            "identify",
            "flight.csv",
            "--model",
            "rigid",
            "--no-figures",
            "--out",
            "identify",
        ),
        "diagnose": (
            "diagnose",
            "flight.csv",
            "--model",
            "rigid",
            "--no-figures",
            "--out",
            "diagnose",
        ),
        "check": ("check", "flight.csv", "--no-figures", "--out", "check"),
    }
    for name, call in calls.items():
        assert both in flat(flightid.done(*call)), name
    for name, file in (
        ("identify", "comparison"),
        ("diagnose", "diagnosis"),
        ("check", "compatibility"),
    ):
        assert (
            f"{SAID}vehicle.toml, flight.json"
            in json.loads((folder / name / f"{file}.json").read_text())["notes"]
        )
    assert f"note: {SAID}flight.json" in flat(flightid.done("predict", "identify", "flight.csv"))


@pytest.mark.long
def test_what_is_named_or_is_not_there_is_not_spoken_of(
    flightid: CommandLine, folder: Path
) -> None:
    Path("flight.json").unlink()
    shutil.move("vehicle.toml", "other.toml")
    for call in (
        ("identify", "flight.csv", "--model", "rigid", "--no-figures"),
        ("check", "flight.csv"),
    ):
        assert "also read" not in flat(flightid.done(*call, "--vehicle", "other.toml"))


@pytest.mark.long
def test_a_survey_names_the_vehicle_file_and_computes_again_where_it_changed(
    flightid: CommandLine, folder: Path
) -> None:
    Path("flights.toml").write_text(
        'model = "rigid"\nrecords = ["flight.csv", "flight_validate.csv"]\n'
    )
    call = ("survey", "flights.toml", "--out", "out", "--no-figures")
    assert f"note: {SAID}vehicle.toml" in flat(flightid.done(*call))
    assert len(json.loads(Path("out/survey.json").read_text())["computed"]) == 2
    flightid.done(*call)
    assert not json.loads(Path("out/survey.json").read_text())["computed"]
    text = Path("vehicle.toml").read_text()
    Path("vehicle.toml").write_text(text.replace("CL_alpha = ", "CL_alpha = 0.1 # was "))
    flightid(*call)
    assert len(json.loads(Path("out/survey.json").read_text())["computed"]) == 2


@pytest.mark.long
def test_a_watch_names_the_json_file(flightid: CommandLine, tmp_path: Path) -> None:
    rows = "".join(
        f"{0.04 * k:.2f},{float(k % 50 < 20)},{0.001 * (k % 7)},{0.001 * (k % 5)},1\n"
        for k in range(400)
    )
    (tmp_path / "record.csv").write_text(f"time,stick,alpha,q,nz\n{rows}")
    (tmp_path / "record.json").write_text(
        '{"schema": "flightid/record/1", "units": {"stick": "in"}}'
    )
    call = flightid(
        "watch", tmp_path / "record.csv", "--model", "loes", "--until-end", "--no-refine"
    )
    assert call.code == 0 and "note: record.json was found beside the record" in call.out
    (tmp_path / "record.json").write_text(
        '{"schema": "flightid/record/1", "units": {"stik": "in"}}'
    )
    assert (
        "there is no channel 'stik'; did you mean 'stick'?"
        in flightid("watch", tmp_path / "record.csv", "--model", "loes", "--until-end").err
    )


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.6912, 1.5])
def test_a_wrong_airspeed_is_offered_in_place_of_the_scale_of_an_accelerometer(
    flightid: CommandLine, folder: Path, factor: float
) -> None:
    text = Path("vehicle.toml").read_text()
    found = re.search(r"(?m)^airspeed = (\S+)$", text)
    assert found is not None
    true = float(found[1])
    Path("vehicle.toml").write_text(text.replace(found[0], f"airspeed = {factor * true!r}"))
    printed = flat(flightid.done("check", "flight.csv", "--no-figures", "--out", "check"))
    said = re.search(
        r"airspeed = (\S+) m/s in place of \S+ in vehicle.toml would explain it as well", printed
    )
    assert said is not None and float(said[1]) == pytest.approx(true, rel=0.05)
    assert any(
        said[0] in warning
        for warning in json.loads((folder / "check" / "compatibility.json").read_text())["warnings"]
    )


@pytest.mark.long
def test_a_recorded_airspeed_leaves_the_vehicle_file_out_of_it(
    flightid: CommandLine, folder: Path, with_column: Callable[[Path, str, float], None]
) -> None:
    with_column(folder / "flight.csv", "airspeed", 138.7)
    printed = flat(flightid.done("check", "flight.csv", "--no-figures"))
    assert "sensor-scale:nz" in printed and "would explain it as well" not in printed


@pytest.fixture
def with_column() -> Callable[[Path, str, float], None]:
    """Adds a constant column to a record."""

    def add(path: Path, name: str, value: float) -> None:
        header, *rows = path.read_text().splitlines()
        path.write_text(
            "\n".join(
                [
                    f"{header},{name}",
                    *(f"{row},{value + 0.01 * (k % 3)}" for k, row in enumerate(rows)),
                ]
            )
            + "\n"
        )

    return add
