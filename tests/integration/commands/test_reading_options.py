"""Every command that reads a record takes the options that open it: names of columns, a rate, a
channel map, a maneuver."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.cli.application import COMMANDS
from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.model import Noise
from sim.maneuvers import doublet, sequence, three_two_one_one
from sim.record import Record
from sim.truth.flight import fly, sample_times
from tests import loes_problem
from tests.bases import LOES_CONSTANTS, LOES_VALUES
from tests.integration.command_line import VEHICLE, CommandLine

NOISE = {"alpha": 5e-4, "q": 5e-4, "nz": 2e-3}
RATE = 20.0
OPENING = {"channels", "columns", "rate"}
BARE = ["--columns", "elevator,alpha,q,nz", "--rate", "20"]
MANEUVER = 'record = "flight.csv"\n[[maneuvers]]\nname = "first"\nfrom = 1.0\nto = 12.0\n'


def flown(folder: Path, seed: int) -> Record:
    """A rigid aircraft's record of 30 s at 20 Hz from rest: a 3-2-1-1 and a doublet."""
    model = model_of_file(read_vehicle(folder / "vehicle.toml", "rigid")).with_noise(Noise(NOISE))
    maneuver = sequence([three_two_one_one(0.03, 1.0), doublet(0.03, 1.0)], 8.0, start=2.0)
    return fly(
        model,
        maneuver,
        sample_times(RATE, 30.0),
        np.random.default_rng(seed),
        step=0.01,
        outputs=list(NOISE),
        name="flight",
    )[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two records with their clock and header, and the first without either; a file of maneuvers;
    tests only read them."""
    made = tmp_path_factory.mktemp("opening")
    (made / "vehicle.toml").write_text(VEHICLE)
    for number, name in enumerate(("flight", "second")):
        record = flown(made, number)
        write_record(made, record, name)
        # it says how the inputs are to be read, which a bare table cannot
        (made / f"{name}.json").unlink()
        columns = np.column_stack(
            [record[each].values for each in ("elevator", "alpha", "q", "nz")]
        )
        np.savetxt(made / f"{name}.txt", columns, fmt="%.17g")
    (made / "parts.toml").write_text(MANEUVER)
    return made


def written(
    flightid: CommandLine, document: str, out: Path, command: str, *options: object
) -> dict[str, Any]:
    """What a command writes."""
    flightid.done(command, *options, "--no-figures", "--out", out)
    content: dict[str, Any] = json.loads((out / document).read_text())
    return content


def test_every_command_that_reads_records_opens_them_alike() -> None:
    every = [command for some in COMMANDS.values() for command in some]
    readers = {
        command.__name__.rstrip("_"): set(inspect.signature(command).parameters)
        for command in every
    }
    readers = {
        name: options for name, options in readers.items() if {"record", "records"} & options
    }
    assert {"identify", "diagnose", "check", "predict", "maneuvers", "map", "watch"} <= set(readers)
    for name, options in readers.items():
        assert OPENING - options <= ({"channels"} if name == "map" else set()), name
        assert {"maneuver", "maneuvers"} <= options or name in ("map", "maneuvers", "watch"), name


def test_maneuvers_of_a_bare_table(flightid: CommandLine, folder: Path, tmp_path: Path) -> None:
    named = written(
        flightid, "maneuvers.json", tmp_path / "named", "maneuvers", folder / "flight.csv"
    )
    bare = written(
        flightid, "maneuvers.json", tmp_path / "bare", "maneuvers", folder / "flight.txt", *BARE
    )
    assert bare["maneuvers"] == named["maneuvers"] and len(named["maneuvers"]) >= 2
    assert "has a clock of its own" in flightid.refused(
        "maneuvers", folder / "flight.csv", "--rate", "20"
    )


@pytest.mark.long
def test_a_check_of_a_bare_table_and_of_a_maneuver(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    vehicle = ["--vehicle", folder / "vehicle.toml"]

    def findings(name: str, *options: object) -> Any:
        joint = written(
            flightid, "compatibility.json", tmp_path / name, "check", *options, *vehicle
        )["joint"]
        return {key: value for key, value in joint.items() if key != "records"}

    assert findings("bare", folder / "flight.txt", *BARE) == findings(
        "named", folder / "flight.csv"
    )
    times = findings("times", folder / "flight.csv", "--from", "1", "--to", "12")
    assert (
        findings(
            "maneuver",
            folder / "flight.csv",
            "--maneuver",
            "first",
            "--maneuvers",
            folder / "parts.toml",
        )
        == times
    )


@pytest.mark.long
def test_a_prediction_of_a_bare_table_and_of_a_maneuver(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    written(
        flightid,
        "comparison.json",
        tmp_path / "study",
        "identify",
        folder / "second.csv",
        "--model",
        "rigid",
    )

    def errors(name: str, *options: object) -> Any:
        return written(
            flightid, "prediction.json", tmp_path / name, "predict", tmp_path / "study", *options
        )["channels"]

    assert errors("bare", folder / "flight.txt", *BARE) == errors("named", folder / "flight.csv")
    times = errors("times", folder / "flight.csv", "--from", "1", "--to", "12")
    assert (
        errors(
            "maneuver",
            folder / "flight.csv",
            "--maneuver",
            "1",
            "--maneuvers",
            folder / "parts.toml",
        )
        == times
    )


@pytest.mark.long
def test_a_diagnosis_and_a_survey_of_bare_tables(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    options = ["--model", "rigid", "--vehicle", folder / "vehicle.toml"]
    named = written(
        flightid, "diagnosis.json", tmp_path / "named", "diagnose", folder / "flight.csv", *options
    )
    bare = written(
        flightid,
        "diagnosis.json",
        tmp_path / "bare",
        "diagnose",
        folder / "flight.txt",
        *options,
        *BARE,
    )
    assert (bare["verdict"], bare["parameters"], bare["error"]) == (
        named["verdict"],
        named["parameters"],
        named["error"],
    )
    survey = tmp_path / "flights.toml"
    for pattern, columns in (
        ("flight.txt", '"elevator,alpha,q,nz"'),
        ("flight.t*", '["elevator", "alpha", "q", "nz"]'),
    ):
        survey.write_text(
            f'model = "rigid"\nrecords = "{folder}/{pattern}"\ncolumns = {columns}\nrate = 20.0\n'
        )
        assert "failed" not in flightid.done("survey", survey, "--no-figures")
    survey.write_text(
        f'model = "rigid"\nrecords = "{folder}/flight.txt"\ncolumns = "elevator,,q"\n'
    )
    assert "a name is empty" in flightid.refused("survey", survey)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream with its header and clock, the same without both, and one whose channels have to be
    computed."""
    made = tmp_path_factory.mktemp("stream")
    record = loes_problem.record(11, duration=6.0)
    start = {
        **{name: 1.15 * value for name, value in LOES_VALUES.items()},
        "L_q": 1.0,
        "delay": 0.05,
    }
    lines = [
        'name = "demonstrator"',
        *(f"{name} = {value}" for name, value in LOES_CONSTANTS.items()),
        "[derivatives]",
    ]
    (made / "vehicle.toml").write_text(
        "\n".join([*lines, *(f"{name} = {value}" for name, value in start.items())]) + "\n"
    )
    rate = 1.0 / float(np.median(np.diff(record.time)))
    (made / "rate").write_text(repr(rate))
    values = {name: record[name].values for name in ("stick", "alpha", "q", "nz")}

    def table(name: str, header: str, columns: list[np.ndarray]) -> None:
        rows = [",".join(repr(float(value)) for value in row) for row in zip(*columns, strict=True)]
        (made / name).write_text("\n".join([*([header] if header else []), *rows]) + "\n")

    time = np.arange(len(record)) / rate
    table("named.csv", "time,stick,alpha,q,nz", [time, *values.values()])
    table("bare.csv", "", list(values.values()))
    apart = [
        1e3 * time,
        2.0 * values["stick"] - 1.0,
        2.0 * np.degrees(values["alpha"]),
        0.0 * time,
        -values["q"],
        values["nz"],
    ]
    table("odd.csv", "ms,pot,left,right,pitch rate,nz", apart)
    (made / "map.toml").write_text(
        'time = {column = "ms", unit = "ms"}\nstick = {column = "pot", scale = 0.5, offset = 0.5}\n'
        'alpha = {column = "0.5*(left + right)", unit = "deg"}\nq = {column = 5, sign = -1}\n'
    )
    return made


@pytest.mark.long
def test_a_stream_is_opened_as_a_record_is(
    flightid: CommandLine, stream: Path, tmp_path: Path
) -> None:
    options = [
        "--model",
        "loes",
        "--vehicle",
        stream / "vehicle.toml",
        "--until-end",
        "--no-refine",
    ]

    def parameters(name: str, *more: object) -> dict[str, Any]:
        flightid.done("watch", stream / f"{name}.csv", *options, *more, "--out", tmp_path / name)
        found: dict[str, Any] = json.loads((tmp_path / name / "comparison.json").read_text())[
            "parameters"
        ]
        return found

    named = parameters("named")
    bare = parameters(
        "bare", "--columns", "stick,alpha,q,nz", "--rate", (stream / "rate").read_text()
    )
    odd = parameters("odd", "--channels", stream / "map.toml")
    for name, row in named.items():
        for other in (bare, odd):
            assert other[name]["estimate"] == pytest.approx(
                row["estimate"], abs=1e-6 * row["std"]
            ), name


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("named", ["--rate", "40"], "the stream has a clock of its own"),
        ("bare", [], "there is no header, the first row holds numbers"),
        ("bare", ["--columns", "stick,alpha,q,nz"], "give --rate HZ"),
        ("bare", ["--columns", "stick,alpha", "--rate", "40"], "2 names for 4 columns"),
        ("named", ['alpha = {column = "alpha", delay = 0.1}'], "rows that have not come yet"),
        ("named", ['alpha = "unwrap(alpha)"'], "unwrap needs the rows before"),
        ("named", ['alpha = "2*beta"'], "there is no column 'beta'"),
    ],
)
def test_streams_that_cannot_be_opened(
    flightid: CommandLine, stream: Path, tmp_path: Path, name: str, options: list[str], said: str
) -> None:
    if options and "=" in options[0]:
        (tmp_path / "map.toml").write_text(options[0])
        options = ["--channels", str(tmp_path / "map.toml")]
    call = [
        "watch",
        stream / f"{name}.csv",
        "--model",
        "loes",
        "--vehicle",
        stream / "vehicle.toml",
        "--until-end",
        *options,
    ]
    assert said in flightid.refused(*call)
