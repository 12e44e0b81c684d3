"""`flightid survey`: flights from their records to a page, in a folder that grows; on simulated
fleets whose truth is known.
"""

from __future__ import annotations

import json
import runpy
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flightid as fid
from scenarios.cli.model_commands import EXAMPLE
from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.effect import full_name
from sim.declaration.model import Noise
from sim.effects.library import effects_for
from sim.maneuvers import three_two_one_one
from sim.truth.flight import fly, sample_times
from tests.integration.command_line import CommandLine, contents
from tests.integration.commands.test_stopping import stopped

FLEET = runpy.run_path(str(Path(__file__).parents[3] / "docs" / "how-to" / "fleet.py"))
LATE = 0.1  # s, two samples
TABLE = '[[flights]]\nrecord = "records/{name}.csv"\nvehicle = {{airspeed = {airspeed}}}\n'
HEAD = 'title = "short"\nmodel = "rigid"\nvehicle = "aircraft.toml"\n'
OWN = ("created", "computed", "new", "removed", "refitted")  # of a run, not of the flights


def short_flights(folder: Path, late: dict[str, float]) -> list[str]:
    """Short records of which these are late by so much, and their tables."""
    (folder / "records").mkdir(parents=True, exist_ok=True)
    for name, values in (("true", FLEET["TRUE"]), ("aircraft", FLEET["STARTS"])):
        (folder / f"{name}.toml").write_text(FLEET["AIRCRAFT"].format(**values))
    vehicle = model_of_file(read_vehicle(folder / "true.toml", "rigid"))
    delay = next(each for each in effects_for(vehicle.equations) if each.name == "sensor-delay:q")
    tables = []
    for number, (name, value) in enumerate(late.items()):
        airspeed = 120.0 + 10.0 * number
        model = vehicle.with_values({"airspeed": airspeed}).with_noise(
            Noise({key: 2.0 * std for key, std in FLEET["NOISE"].items()})
        )
        if value:
            model = model.with_effects(delay).with_values({full_name(delay, "delay"): value})
        maneuver = three_two_one_one(np.radians(2.0), 0.5, 0.5)
        rng = np.random.default_rng([7, number])
        record, _ = fly(
            model,
            maneuver,
            sample_times(20.0, 7.0),
            rng,
            step=0.005,
            outputs=list(FLEET["NOISE"]),
            name=name,
        )
        write_record(folder / "records", record, name, simulated=True)
        tables.append(TABLE.format(name=name, airspeed=airspeed))
    return tables


def document(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(
        (out / "survey.json").read_text(), parse_constant=pytest.fail
    )
    return content


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, fid.Survey]:
    """Three flights, two of them late, surveyed and written with figures; tests only read it."""
    folder = tmp_path_factory.mktemp("fleet")
    tables = short_flights(folder, {"a": LATE, "b": 0.0, "c": LATE})
    (folder / "flights.toml").write_text(HEAD + "\n".join(tables))
    found = fid.survey(folder / "flights.toml", folder / "morning", jobs=1)
    found.save(folder / "morning", figures="png")
    return folder, found


@pytest.mark.long
def test_a_survey_finds_what_recurs_and_writes_it(surveyed: tuple[Path, fid.Survey]) -> None:
    folder, found = surveyed
    assert found.effects == ("sensor-delay:q",)
    assert found.flights == found.computed == ("a", "b", "c")
    probability = found.recurring()["sensor-delay:q"]
    assert [probability[name] > 0.95 for name in "abc"] == [True, False, True]
    (effect,) = document(folder / "morning")["effects"]
    delay = effect["parameters"]["delay"]
    assert abs(delay["value"] - LATE) < 4.0 * delay["std"]
    assert effect["belongs_to"] == "some flights"
    table = found.to_dataframe()
    for name, true in FLEET["TRUE"].items():
        assert np.all(np.abs(table[name] - true) < 4.5 * table[f"{name}_std"]), name
    assert list(table["airspeed"]) == [120.0, 130.0, 140.0]
    page = (folder / "morning" / "report.html").read_text()
    assert "in 2 of 3 flights" in page
    assert page.count("<svg") == 3
    written = contents(folder / "morning")
    assert {
        "survey.json",
        "derivatives.csv",
        "report.html",
        "report.json",
        "effects.png",
        "shared.png",
        "over_airspeed.png",
    } <= set(written)
    for name in "abc":
        assert f'href="flights/{name}/report.html"' in page
        assert written[f"flights/{name}/report.html"]
    assert "sensor-delay:q" in found.summary()


@pytest.mark.long
def test_a_second_survey_by_the_command_computes_nothing(
    flightid: CommandLine, surveyed: tuple[Path, fid.Survey], tmp_path: Path
) -> None:
    folder, _ = surveyed
    shutil.copytree(folder, tmp_path / "fleet")
    flights, out = tmp_path / "fleet" / "flights.toml", tmp_path / "fleet" / "morning"
    before = document(out)
    printed = flightid.done("survey", flights, "--out", out, "--no-figures", "--jobs", 2)
    assert "0 computed now, 3 kept" in printed
    assert "RECURS: sensor-delay:q" in printed
    after = document(out)
    assert {key: after[key] for key in after if key not in (*OWN, "files")} == {
        key: before[key] for key in before if key not in (*OWN, "files")
    }
    assert not (out / "effects.png").exists()
    flightid.done("report", out)
    assert "in 2 of 3 flights" in (out / "report.html").read_text()
    flights.write_text(
        flights.read_text()
        .replace('title = "short"', 'title = "renamed"')
        .partition('[[flights]]\nrecord = "records/c')[0]
    )
    told = json.loads(flightid.done("survey", flights, "--out", out, "--no-figures", "--json"))
    assert (told["title"], told["removed"], told["computed"]) == ("renamed", ["c"], [])


def test_the_example_is_printed_and_faults_are_one_line(
    flightid: CommandLine, tmp_path: Path
) -> None:
    assert flightid.done("survey", "--example") == EXAMPLE
    assert "no file is named" in flightid.refused("survey")
    (tmp_path / "aircraft.toml").write_text(FLEET["AIRCRAFT"].format(**FLEET["STARTS"]))
    for text, said in (
        (HEAD + 'colour = "red"\n', "colour"),
        (HEAD + 'records = "none/*.csv"\n', "no file matches"),
        (
            HEAD + '[[flights]]\nrecord = "a.csv"\nvehicle = {mass = "5 blorb"}\n',
            "flight a, mass: unknown unit",
        ),
        (HEAD + 2 * '[[flights]]\nrecord = "a.csv"\n', "two flights are called a"),
    ):
        (tmp_path / "flights.toml").write_text(text)
        assert said in flightid.refused(
            "survey", tmp_path / "flights.toml", "--out", tmp_path / "out"
        )
    assert not (tmp_path / "out").exists()
    assert "gone.toml" in flightid.refused("survey", tmp_path / "gone.toml")


def test_a_survey_of_no_usable_flight_says_so(flightid: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "aircraft.toml").write_text(FLEET["AIRCRAFT"].format(**FLEET["STARTS"]))
    (tmp_path / "flights.toml").write_text(HEAD + '[[flights]]\nrecord = "gone.csv"\n')
    printed = flightid.done("survey", tmp_path / "flights.toml", "--out", tmp_path / "out")
    assert "NO FLIGHT: no flight could be used" in printed
    assert "gone failed: " in printed
    assert document(tmp_path / "out")["failed"]["gone"]


# Flights of which the first two are clean and end at once; the third never ends.
NEVER_ENDING = """
import pathlib, sys, time
from scenarios.cli import main
from scenarios.survey import flights

plain = flights.diagnosed

def diagnosed(flight, folder, figures):
    if flight.name == "c":
        pathlib.Path("begun").write_text("")
        time.sleep(60)
    return plain(flight, folder, figures)

flights.diagnosed = diagnosed
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_ctrl_c_keeps_the_flights_that_have_ended(flightid: CommandLine, tmp_path: Path) -> None:
    tables = short_flights(tmp_path, {"a": 0.0, "b": 0.0, "c": 0.0})
    (tmp_path / "flights.toml").write_text(HEAD + "\n".join(tables))
    arguments = ("survey", "flights.toml", "--jobs", "1", "--no-figures", "--out", "morning")
    code, _, err = stopped(NEVER_ENDING, tmp_path, *arguments)
    assert code == 130
    assert "2 of 3 flights are kept in morning" in err.splitlines()[-1]
    assert "Traceback" not in err
    assert not (tmp_path / "morning" / "survey.json").exists()
    printed = flightid.done(
        "survey",
        tmp_path / "flights.toml",
        "--jobs",
        1,
        "--no-figures",
        "--out",
        tmp_path / "morning",
    )
    assert "3 flights; 1 computed now, 2 kept" in printed


@pytest.mark.slow
def test_two_processes_write_the_same_survey(
    surveyed: tuple[Path, fid.Survey], tmp_path: Path
) -> None:
    folder, _ = surveyed
    fid.survey(folder / "flights.toml", tmp_path / "two", jobs=2).save(
        tmp_path / "two", figures="png"
    )
    one, two = document(folder / "morning"), document(tmp_path / "two")
    assert {key: one[key] for key in one if key != "created"} == {
        key: two[key] for key in two if key != "created"
    }
    for name in (
        "derivatives.csv",
        "effects.png",
        "shared.png",
        "over_airspeed.png",
        "flights/a/sets.json",
        "flights/c/diagnosis.json",
    ):
        first, second = (
            (where / name).read_bytes() for where in (folder / "morning", tmp_path / "two")
        )
        if name.endswith("diagnosis.json"):
            first, second = (
                json.dumps({k: v for k, v in json.loads(each).items() if k not in TIMES}).encode()
                for each in (first, second)
            )
        assert first == second, name


TIMES = ("created", "timing", "seconds", "duration", "run_time")


@pytest.mark.slow
def test_a_fleet_with_a_nose_boom_and_a_late_channel_in_half_of_it(tmp_path: Path) -> None:
    FLEET["simulate_fleet"](tmp_path, 12, seed=31)
    found = fid.survey(tmp_path / "flights.toml", tmp_path / "morning")
    assert sorted(found.effects) == ["sensor-delay:q", "vane-offset"]
    content = found.to_dict()
    truth = json.loads((tmp_path / "truth.json").read_text())["flights"]
    for effect in content["effects"]:
        for local, q in effect["parameters"].items():
            (true,) = {
                flight[f"{effect['name']}.{local}"]
                for flight in truth.values()
                if f"{effect['name']}.{local}" in flight
            }
            assert abs(q["value"] - true) < 3.0 * q["std"], effect["name"]
        for name, told in effect["flights"].items():
            acts = any(key.startswith(f"{effect['name']}.") for key in truth[name])
            assert told["state"] == ("has it" if acts else "does not have it"), (
                effect["name"],
                name,
            )
    (line,) = found.trends
    assert line.startswith("Cm_alpha changes with mass")
    slope = content["derivatives"]["Cm_alpha"]["trends"]["mass"]
    assert (
        abs(slope["slope"] - FLEET["TRUE"]["Cm_alpha"] * FLEET["DRIFT"] / 1000.0)
        < 3.0 * slope["std"]
    )
    assert found.standing_out == ()
    FLEET["simulate_fleet"](tmp_path, 13, seed=31)
    again = fid.survey(tmp_path / "flights.toml", tmp_path / "morning")
    assert again.computed == ("flight013",)
    assert sorted(again.effects) == ["sensor-delay:q", "vane-offset"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
def test_a_fleet_without_effects_shows_none(tmp_path: Path, seed: int) -> None:
    FLEET["simulate_fleet"](tmp_path, 12, seed=seed, boom=0.0, late=0.0)
    found = fid.survey(tmp_path / "flights.toml", tmp_path / "morning")
    assert found.effects == ()
    assert [line.partition(" changes ")[0] for line in found.trends] == ["Cm_alpha"]
    assert found.standing_out == ()
