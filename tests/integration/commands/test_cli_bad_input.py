"""Bad usage and bad input: exit code 2, one line that names file and place and says what to do,
nothing written.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.integration.command_line import VEHICLE, CommandLine, contents

Edit = Callable[[list[str]], str]
ROW = 5  # the sixth line of the file, at 0.04 s


def with_row(text: str) -> Edit:
    """The record with line 6 replaced."""
    return lambda lines: "\n".join([*lines[:ROW], text, *lines[ROW + 1 :]]) + "\n"


def with_header(text: str) -> Edit:
    return lambda lines: "\n".join([text, *lines[1:]]) + "\n"


def emptied(lines: list[str]) -> str:
    """The record without a number in alpha."""
    cells = [line.split(",") for line in lines[1:]]
    return "\n".join([lines[0], *(",".join([row[0], row[1], "", row[3]]) for row in cells)]) + "\n"


RECORDS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    "missing column": (
        with_header("time,elev,alpha,q"),
        ("header", "no column 'elevator'", "time, elev, alpha, q", "--channels"),
    ),
    "no output": (with_header("time,elevator,a,b"), ("header", "no column 'alpha'", "--channels")),
    "unknown unit": (
        with_header("time,elevator,alpha [foo],q"),
        ("column 'alpha [foo]'", "unknown unit 'foo'", "write rad, deg"),
    ),
    "wrong dimension": (
        with_header("time,elevator,alpha_kg,q"),
        ("column 'alpha_kg'", "'kg' does not measure an angle", "write rad, deg"),
    ),
    "channel without a number": (
        emptied,
        ("column 'alpha'", "not a single number", "leave the column out"),
    ),
    "text": (
        with_row("0.04,0,bad,0"),
        ("row 6, column 'alpha'", "'bad' is not a number", "leave the cell empty"),
    ),
    "infinite value": (
        with_row("0.04,0,inf,0"),
        ("row 6, column 'alpha'", "infinite", "leave the cell empty"),
    ),
    "number beyond measure": (
        with_row("0.04,0,1e300,0"),
        ("channel alpha at 0.04 s", "1e+300 is no measurement"),
    ),
    "missing input sample": (
        with_row("0.04,,0,0"),
        ("row 6, column 'elevator'", "missing", "fill the gap"),
    ),
    "missing time": (
        with_row(",0,0,0"),
        ("row 6, column 'time'", "time is missing", "give every row a time"),
    ),
    "infinite time": (
        with_row("inf,0,0,0"),
        ("row 6, column 'time'", "time is infinite", "finite time"),
    ),
    "time goes back": (
        with_row("0.01,0,0,0"),
        ("row 6, column 'time'", "goes back (0.03 s, then 0.01 s)", "sort the rows"),
    ),
    "time twice": (
        with_row("0.03,0,0.7,0"),
        ("row 6, column 'time'", "repeated", "remove duplicates"),
    ),
    "one sample": (
        lambda lines: "\n".join(lines[:2]),
        ("row 2", "one sample", "at least two rows"),
    ),
    "empty file": (lambda lines: "", ("the file is empty", "give a header row")),
    "header without rows": (
        lambda lines: lines[0] + "\n",
        ("header but no rows", "give one row a sample"),
    ),
    "ragged": (with_row("0.04,0,0"), ("row 6", "3 cells under a header of 4")),
    "decimal commas": (
        lambda lines: "\n".join([*lines, "8,01,0,0,0"]),
        ("row ", "cells under a header of 4"),
    ),
}

VEHICLES: dict[str, tuple[tuple[str, str], tuple[str, ...]]] = {
    "wrong key": (("chord =", "cord ="), ("key cord", "no such key", "did you mean 'chord'?")),
    "missing key": (("Cm_q = -28.0\n", ""), ("key missing: derivatives.Cm_q", "add it")),
    "negative mass": (
        ('"288017 lb"', "-1.0"),
        ("key mass", "-1 is not above 0", "give a value above 0"),
    ),
    "negative mass with a unit": (('"288017 lb"', '"-288017 lb"'), ("key mass", "is not above 0")),
    "infinite": (('"288017 lb"', "inf"), ("key mass", "not a finite number")),
    "unknown unit": (
        ("288017 lb", "288017 stones and a half"),
        ("key mass", "unknown unit", "write kg, lb or slug"),
    ),
    "wrong dimension": (
        ("288017 lb", "288017 m"),
        ("key mass", "'m' does not measure a mass", "write kg, lb or slug"),
    ),
    "text": (("4.66344", '"long"'), ("key chord", "'long' is not a number with a unit")),
    "bound below the start": (
        ("Cm_de = -2.1", "Cm_de = -2.1\n[bounds]\nCm_q = [-20.0, 0.0]"),
        ("key bounds.Cm_q", "the start -28 lies outside"),
    ),
    "tie that is text": (
        ("Cm_de = -2.1", 'Cm_de = -2.1\n[tied]\nCm_z = "2 * Cm_de"'),
        ("key tied.Cm_z", "no parameter 'Cm_z'", "did you mean"),
    ),
    "not TOML": (("[derivatives]", "[derivatives"), ("not valid TOML", "line 9")),
}

MAPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "wrong channel": (
        'alhpa = "AoA"',
        ("map.toml, key alhpa", "no such key", "did you mean 'alpha'?"),
    ),
    "wrong key": (
        'alpha = {colum = "alpha"}',
        ("map.toml, key alpha.colum", "did you mean 'column'?"),
    ),
    "column that is not there": (
        'alpha = {column = "AoA1"}',
        (
            "record.csv, header",
            "'AoA1', which the channel map names for alpha",
            "correct the channel map",
        ),
    ),
    "unknown unit": (
        'alpha = {column = "alpha", unit = "foo"}',
        ("record.csv, column 'alpha'", "unknown unit 'foo'"),
    ),
    "wrong dimension": (
        'alpha = {column = "alpha", unit = "m"}',
        ("record.csv, column 'alpha'", "does not measure an angle"),
    ),
}

# Options after `identify RECORD --model rigid --vehicle V`; a later --model stands.
OPTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "unknown option": (("--foo",), ("no such option: --foo", "identify --help")),
    "wrong model": (("--model", "rigit"), ("--model", "no model 'rigit'", "use one of", "rigid")),
    "wrong method": (
        ("--method", "magic"),
        ("--method", "no method 'magic'", "use one of ekf", "output-error"),
    ),
    "from is no number": (("--from", "soon"), ("'--from'", "valid number", "identify --help")),
    "from beyond the end": (
        ("--from", "99"),
        ("record.csv", "no row between --from and --to", "covers 0 to 8 s"),
    ),
    "to before the start": (("--to", "-1"), ("record.csv", "covers 0 to 8 s")),
    "from after to": (
        ("--from", "3", "--to", "2"),
        ("--from 3 is not before --to 2", "give the earlier time first"),
    ),
    "profile of nothing estimated": (
        ("--profile", "Cm_z"),
        ("--profile", "no parameter 'Cm_z' is estimated", "did you mean"),
    ),
    "profile of a filter": (
        ("--profile", "Cm_q", "--method", "ekf"),
        ("--profile", "ekf has no likelihood", "use --method output-error"),
    ),
    "band in time": (
        ("--band", "0.1", "2"),
        ("--band", "output-error has no band", "--method frequency-domain"),
    ),
    "no band": (
        ("--method", "frequency-domain", "--band", "2", "1"),
        ("--band", "2 to 1 Hz is no band", "lower frequency first"),
    ),
    "empty band": (
        ("--method", "frequency-domain", "--band", "0.13", "0.14"),
        ("record.csv", "no harmonic of", "widen --band"),
    ),
    "validate on the record itself": (
        ("--validate", "record.csv"),
        ("record.csv", "the record is named twice"),
    ),
    "no channel map": (
        ("--channels", "absent.toml"),
        ("absent.toml", "no such file", "check the path"),
    ),
    "no vehicle file": (
        ("--vehicle", "absent.toml"),
        ("absent.toml", "no such file", "check the path"),
    ),
}

USAGE: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "unknown command": (("fly",), ("no such command 'fly'", "--help")),
    "unknown option before the command": (("--foo",), ("no such option: --foo",)),
    "run nothing": (("run",), ("missing argument 'NAME...'",)),
    "run an unknown scenario": (("run", "rigit"), ("no scenario 'rigit'", "did you mean 'rigid'?")),
    "run a file that is not there": (("run", "absent.toml"), ("absent.toml", "no such file")),
    "run twice": (("run", "rigid", "rigid"), ("rigid is named twice", "once")),
    "seed": (("run", "rigid", "--seed", "-1"), ("'--seed'",)),
    "set without a value": (
        ("run", "rigid", "--set", "flight.rate"),
        ("--set", "not key=value", "flight.rate=50"),
    ),
    "set a wrong key": (
        ("run", "rigid", "--set", "flight.rat=50"),
        ("rigid.toml, key flight.rat", "did you mean 'rate'?"),
    ),
    "set a wrong entry": (
        ("run", "rigid", "--set", "flight.maneuvers.2.unit=1"),
        ("--set", "no entry '2'", "from 1 to 1"),
    ),
    "list an unknown scenario": (("list", "rigit"), ("no scenario 'rigit'",)),
    "simulate without a file": (("simulate", "rigid"), ("missing option '--out'",)),
    "simulate into another format": (
        ("simulate", "rigid", "--out", "flight.txt"),
        ("flight.txt", ".txt", ".csv"),
    ),
    "identify nothing": (("identify",), ("missing argument 'RECORD...'",)),
    "identify without a model": (("identify", "r.csv"), ("missing option '--model'",)),
    "an effort that there is not": (
        ("diagnose", "r.csv", "--model", "rigid", "--effort", "heroic"),
        ("--effort", "no effort 'heroic'", "thorough"),
    ),
    "a campaign of one run": (("campaign", "rigid", "--runs", "1"), ("'--runs'", "2")),
    "a campaign by no method": (
        ("campaign", "ballistic", "--runs", "2", "--method", "one-pas"),
        ("--method", "no method 'one-pas'", "'one-pass'"),
    ),
    "a campaign of an examination": (
        ("campaign", "clean-models", "--runs", "2"),
        ("clean-models", "python -m exam clean --help"),
    ),
    "a campaign of hidden effects": (
        ("campaign", "trace-vane", "--runs", "2"),
        ("trace-vane", "python -m exam hidden-effects trace-vane"),
    ),
    "run a surrogate flight": (
        ("run", "standin-one"),
        ("standin-one", "python -m exam surrogate surrogate-one"),
    ),
    "simulate a surrogate flight": (
        ("simulate", "standin-none", "--out", "f.csv"),
        ("python -m exam surrogate surrogate-none",),
    ),
    "effects": (("effects", "input-dealy"), ("no effect 'input-dealy'", "input-delay")),
    "vehicles": (("vehicles", "bomber"), ("no vehicle 'bomber'", "bomber_rigid")),
    "vehicles without a name": (
        ("vehicles", "--diff", "bomber_ac1"),
        ("--diff", "name one before it"),
    ),
}

# Changes of the scenario `rigid` that are wrong, in its file or with --set.
SCENARIOS: dict[str, tuple[str, tuple[str, ...]]] = {
    "vehicle": ('flight.vehicle="concorde"', ("no vehicle 'concorde'", "bomber_rigid")),
    "negative duration": ("flight.duration=-8", ("key flight.duration", "not above 0")),
    "negative variance": (
        "flight.noise_variance.alpha=-1 deg^2",
        ("key flight.noise_variance.alpha", "not above 0"),
    ),
    "unit": (
        "flight.noise_variance.alpha=1 kg^2",
        ("key flight.noise_variance.alpha", "does not measure an angle"),
    ),
    "maneuver": (
        'flight.maneuvers.1.kind="loop"',
        ("key flight.maneuvers[1].kind", "'loop'", "'doublet'"),
    ),
    "input": (
        'flight.maneuvers.1.input="rudder"',
        ("key flight.maneuvers[1]", "no input 'rudder'", "elevator"),
    ),
    "output": ('estimate.outputs=["beta"]', ("no output 'beta'", "alpha, q, nz")),
    "few factors": (
        "sweep.frequency_factors=[1, 2]",
        ("key sweep.frequency_factors", "2 of at least 3 entries", "give 3 or more"),
    ),
    "no output": ("estimate.outputs=[]", ("key estimate.outputs", "nothing in it")),
    "parameter": (
        "estimate.start.CL_beta={value=1, std=1}",
        ("key start", "no parameter 'CL_beta'", "CL_alpha"),
    ),
    "spread of zero": ("estimate.start.CL_q.std=0", ("key estimate.start.CL_q.std", "not above 0")),
    "started and held": ("estimate.held.CL_q=-15", ("key held", "under start and under held")),
    "process noise on nothing": (
        "estimate.process_noise.beta=1",
        ("key process_noise", "'beta' is no state"),
    ),
    "method": ('estimate.method="magic"', ("key estimate.method", "'magic'", "'ekf'")),
    "reason of nothing": (
        'own.flight.rat="none"',
        ("key own.flight.rat", "no such value", "leave it out"),
    ),
    "choice without a reason": (
        "own.flight.rate=7",
        ("key own.flight.rate", "7 is no reason", "in words"),
    ),
    "flight of the main method": (
        "estimate.flight={rate=50}",
        ("key estimate.flight", "no such key"),
    ),
    "another vehicle for a method": (
        'methods=[{name="a", flight={vehicle="bomber_ac1"}}]',
        ("key methods[1].flight.vehicle", "no such key"),
    ),
    "wrong rate of a method's flight": (
        'methods=[{name="a", flight={rate="-5 Hz"}}]',
        ("key methods[1].flight.rate", "not above 0"),
    ),
    "distance of no flight": (
        'methods=[{name="a", distance="same equations and step"}]',
        ("key methods[1].distance", "scenario's flight"),
    ),
    "reason of a method's nothing": (
        'methods=[{name="a", own={term="one"}}]',
        ("key methods[1].own.term", "no such value"),
    ),
    "schema": ('schema="flightid/scenario/9"', ("key schema", "flightid/scenario/1")),
}


@pytest.fixture
def place(tmp_path: Path, rigid_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder: a sound record and a sound vehicle file."""
    (tmp_path / "record.csv").write_bytes((rigid_folder / "record.csv").read_bytes())
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def identify(*options: str, record: str = "record.csv") -> tuple[str, ...]:
    return (
        "identify",
        record,
        "--model",
        "rigid",
        "--vehicle",
        "vehicle.toml",
        *options,
        "--no-figures",
        "--out",
        "out",
    )


def refused(
    flightid: CommandLine, folder: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    before = contents(folder)
    message = flightid.refused(*arguments)
    for part in parts:
        assert part in message, message
    assert contents(folder) == before and not (folder / "out").exists()


@pytest.mark.long
@pytest.mark.parametrize("case", RECORDS)
def test_record(flightid: CommandLine, place: Path, case: str) -> None:
    edit, parts = RECORDS[case]
    (place / "wrong.csv").write_text(edit((place / "record.csv").read_text().splitlines()))
    refused(flightid, place, identify(record="wrong.csv"), ("wrong.csv", *parts))


@pytest.mark.long
def test_record_in_another_encoding(flightid: CommandLine, place: Path) -> None:
    (place / "wrong.csv").write_bytes(
        "time,elevator,alpha,q\n0,0,0,0\n0.1,0,0,0°\n".encode("latin-1")
    )
    refused(
        flightid,
        place,
        identify(record="wrong.csv"),
        ("wrong.csv, row 3", "'0°' is not a number", "write a number"),
    )


def test_record_that_is_not_there(flightid: CommandLine, place: Path) -> None:
    refused(
        flightid,
        place,
        identify(record="absent.csv"),
        ("absent.csv", "no such file", "check the path"),
    )
    refused(flightid, place, identify(record="."), ("this is a folder",))


@pytest.mark.sampled
@pytest.mark.parametrize("case", VEHICLES)
def test_vehicle_file(flightid: CommandLine, place: Path, case: str) -> None:
    (before, after), parts = VEHICLES[case]
    assert VEHICLE.count(before) == 1
    (place / "vehicle.toml").write_text(VEHICLE.replace(before, after))
    refused(flightid, place, identify(), ("vehicle.toml", *parts))


@pytest.mark.parametrize("case", MAPS)
def test_channel_map(flightid: CommandLine, place: Path, case: str) -> None:
    text, parts = MAPS[case]
    (place / "map.toml").write_text(text)
    refused(flightid, place, identify("--channels", "map.toml"), parts)


@pytest.mark.sampled
@pytest.mark.parametrize("case", OPTIONS)
def test_option_of_identify(flightid: CommandLine, place: Path, case: str) -> None:
    options, parts = OPTIONS[case]
    refused(flightid, place, identify(*options), parts)


@pytest.mark.sampled
@pytest.mark.parametrize("case", USAGE)
def test_usage(flightid: CommandLine, place: Path, case: str) -> None:
    arguments, parts = USAGE[case]
    refused(flightid, place, arguments, parts)


@pytest.mark.sampled
@pytest.mark.parametrize("case", SCENARIOS)
def test_scenario(flightid: CommandLine, place: Path, case: str) -> None:
    change, parts = SCENARIOS[case]
    refused(
        flightid, place, ("run", "rigid", "--set", change, "--out", "out"), ("rigid.toml", *parts)
    )


def test_a_wrong_scenario_file_is_named(flightid: CommandLine, place: Path) -> None:
    text = flightid.done("list", "rigid")
    for before, after, parts in (
        (
            'rate = "100 Hz"',
            'rates = "100 Hz"',
            ("mine.toml, key flight.rates", "did you mean 'rate'?"),
        ),
        ('vehicle = "bomber_rigid"', 'vehicle = "bomber"', ("mine.toml", "no vehicle 'bomber'")),
        ("[flight]", "[flight", ("mine.toml", "not valid TOML", "line")),
    ):
        assert text.count(before) == 1
        (place / "mine.toml").write_text(text.replace(before, after))
        refused(flightid, place, ("run", "mine.toml", "--out", "out"), parts)


@pytest.mark.long
def test_out_that_is_a_file(flightid: CommandLine, place: Path) -> None:
    for out, parts in (
        ("vehicle.toml", ("vehicle.toml", "a file, not a folder")),
        ("vehicle.toml/sub", ("vehicle.toml/sub", "cannot be written")),
    ):
        refused(flightid, place, (*identify()[:-1], out), (*parts, "name a"))
    refused(
        flightid,
        place,
        ("run", "rigid", "--no-figures", "--out", "vehicle.toml"),
        ("a file, not a folder",),
    )
    refused(
        flightid,
        place,
        ("simulate", "rigid", "--out", "vehicle.toml/record.csv"),
        ("cannot be written",),
    )
