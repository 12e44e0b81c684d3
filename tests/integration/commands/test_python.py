"""`import flightid` says what the commands say, to the last bit: the same study folders, texts,
numbers and refusals.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import flightid as fid
from scenarios.api.tables import as_keywords
from tests.integration.command_line import CommandLine, contents

SLOWER = {"flight.rate": 20}  # Hz
SLOWLY = ("--set", "flight.rate=20")


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rigid record without a sidecar, so that nobody says how its inputs are to be read."""
    path = tmp_path_factory.mktemp("flight") / "flight.csv"
    fid.simulate("rigid", seed=3, set=SLOWER).record.to_pandas().to_csv(path)
    return path


@pytest.fixture(scope="module")
def table(flight: Path) -> pandas.DataFrame:
    return pandas.read_csv(flight)


def lines(text: str) -> list[str]:
    """What was printed, without where more is written and how long it took."""
    return [
        line.rstrip()
        for line in text.splitlines()
        if not line.startswith(("written to", "seconds:", "details ")) and line.strip()
    ]


def timeless(folder: Path) -> dict[str, Any]:
    """Every file of a study but its page; documents without the times that they hold."""
    found: dict[str, Any] = {
        name: raw
        for name, raw in contents(folder).items()
        if not name.endswith((".html", "study.txt"))
    }
    for name in (name for name in found if name.endswith(".json")):
        found[name] = {
            key: value
            for key, value in json.loads(found[name]).items()
            if key not in ("seconds", "created")
        }
    # rows have the times that they took
    return {name: content for name, content in found.items() if not name.startswith("runs/")}


@pytest.mark.long
def test_identify(
    flightid: CommandLine, flight: Path, table: pandas.DataFrame, vehicle: Path, tmp_path: Path
) -> None:
    options = (
        "--no-figures",
        "--out",
        tmp_path / "command",
        "--state-space",
        tmp_path / "matrices.json",
    )
    printed = flightid.done("identify", flight, "--model", "rigid", "--vehicle", vehicle, *options)
    found = fid.identify(flight, "rigid", vehicle)
    assert lines(found.summary()) == [
        line for line in lines(printed) if not line.startswith("matrices")
    ]
    found.save(tmp_path / "python", figures=False)
    assert timeless(tmp_path / "python") == timeless(tmp_path / "command")
    of_table = fid.identify(table, "rigid", vehicle)
    written = json.loads((tmp_path / "command" / "comparison.json").read_text())
    assert {name: (p.value, p.sigma, p.unit) for name, p in of_table.parameters.items()} == {
        name: (row["estimate"], row["std"], row["unit"])
        for name, row in written["parameters"].items()
    }
    printed = flightid.done(
        "predict",
        tmp_path / "command",
        flight,
        "--from",
        2.0,
        "--no-figures",
        "--out",
        tmp_path / "predicted",
    )
    prediction = fid.predict(tmp_path / "command", flight, start=2.0)
    made = tmp_path / "made.csv"
    made.write_bytes(flight.read_bytes())
    made.with_suffix(".json").write_text('{"schema": "flightid/record/1", "origin": "simulated"}')
    told = fid.predict(tmp_path / "command", made, start=2.0)
    assert told.details.simulated and not prediction.details.simulated, (
        "its figure calls a record what the file beside it says"
    )
    assert lines(prediction.summary()) == lines(printed)
    assert timeless(prediction.save(tmp_path / "predicted in python", figures=False)) == timeless(
        tmp_path / "predicted"
    )
    assert fid.predict(found, table, start=2.0).to_dataframe().equals(prediction.to_dataframe())
    matrices, space = (
        json.loads((tmp_path / "matrices.json").read_text()),
        of_table.to_state_space(),
    )
    assert (space.A.tolist(), space.B.tolist()) == (matrices["A"], matrices["B"])
    assert (space.state_labels, space.input_labels, space.output_labels) == (
        ["alpha", "q"],
        ["elevator"],
        ["alpha", "q"],
    )


def test_identify_on_one_record_what_another_is_predicted_by(
    flight: Path, table: pandas.DataFrame, vehicle: Path, tmp_path: Path
) -> None:
    found = fid.identify(
        table, "rigid", vehicle, start=0.0, stop=5.0, validate=flight, profile=["Cm_q"]
    )
    errors = found.errors()
    assert (
        errors.loc[("flight.csv", "q"), "held_out"] and not errors.loc[("record", "q"), "held_out"]
    )
    assert found.converged and (errors["fit_percent"] > 90.0).all()
    low, high = found.intervals["Cm_q"]
    assert low < found["Cm_q"].value < high and low == pytest.approx(
        found["Cm_q"].interval[0], rel=0.02
    )
    response = found.response(1)
    left = response["alpha"] - response["predicted_alpha"]
    assert len(left) == len(table) and left.std() == pytest.approx(
        errors.loc[("flight.csv", "alpha"), "rms"], rel=0.02
    )
    shown = getattr(found.plot.fit(), "_repr_png_")  # noqa: B009
    assert found.plot.held_out().axes and shown().startswith(b"\x89PNG")
    inside = fid.plot.interactive(found.plot.fit(), 'fitted & "measured"')
    frame = inside._repr_html_()
    (held,) = re.findall(r'srcdoc="([^"]*)"', frame)
    assert unescape(held) == inside.html and 'title="fitted &amp; &quot;measured&quot;"' in frame
    assert inside.save(written := tmp_path / "fit.html") == written
    assert written.read_text(encoding="utf-8") == inside.html


@pytest.mark.long
def test_diagnose(
    flightid: CommandLine, flight: Path, table: pandas.DataFrame, vehicle: Path, tmp_path: Path
) -> None:
    printed = flightid.done(
        "diagnose",
        flight,
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--no-figures",
        "--out",
        tmp_path / "command",
    )
    found = fid.diagnose(fid.read_record(table, name="flight.csv"), "rigid", vehicle)
    assert lines(found.summary()) == lines(printed)
    found.save(tmp_path / "python", figures=False)
    ours, theirs = timeless(tmp_path / "python"), timeless(tmp_path / "command")
    for study in (ours, theirs):
        study["diagnosis.json"]["inputs"].pop("sha256")  # a table in memory is not the file
        study["report.json"]["reproduction"].pop("inputs")
    assert ours == theirs
    assert (
        found.verdict == "consistent"
        and found.effects == ()
        and found.parameters.to_dict() == pytest.approx(found.before.to_dict(), rel=1e-6)
    )
    assert "flight.csv" in found.report(tmp_path / "report.html", figures=False).read_text()
    assert set(found.prediction().columns) == {
        "elevator",
        *(f"{when}{name}" for name in ("alpha", "q") for when in ("", "before_", "after_")),
    }


def test_check(flightid: CommandLine, tmp_path: Path) -> None:
    record = fid.read_record(
        fid.simulate("rigid", set=SLOWER).record.to_pandas(), name="flight.csv"
    )
    path = tmp_path / "flight.csv"
    record.to_pandas().to_csv(path)
    printed = flightid.done("check", path, "--no-figures", "--out", tmp_path / "command")
    found = fid.check(path)
    assert lines(found.summary()) == lines(printed)
    found.save(tmp_path / "python", figures=False)
    assert timeless(tmp_path / "python") == timeless(tmp_path / "command")
    assert fid.check(record).sentences == found.sentences and "gain" in found.to_dataframe()


@pytest.mark.long
def test_run_simulate_and_campaign(flightid: CommandLine, tmp_path: Path) -> None:
    flightid.done(
        "run", "rigid", "--seed", 2, *SLOWLY, "--no-figures", "--out", tmp_path / "command"
    )
    study = fid.run("rigid", seed=2, set=SLOWER)
    whole = (tmp_path / "command" / "study.txt").read_text(encoding="utf-8")
    assert lines(study.summary()) == lines(whole)
    study.save(tmp_path / "python", figures=False)
    assert timeless(tmp_path / "python") == timeless(tmp_path / "command")
    flightid.done("simulate", "rigid", "--seed", 2, *SLOWLY, "--out", tmp_path / "flight.csv")
    assert (
        fid.read_record(tmp_path / "flight.csv")
        .to_pandas()
        .equals(fid.simulate("rigid", seed=2, set=["flight.rate=20"]).record.to_pandas())
    )
    assert (study.to_dataframe()["sigmas"].abs() < 4.0).all() and study.true["Cm_q"] == -34.75
    printed = flightid.done("campaign", "rigid", "--runs", 3, *SLOWLY, "--out", tmp_path / "many")
    campaign = fid.campaign("rigid", 3, set=SLOWER)
    assert isinstance(campaign, fid.Campaign)
    assert lines(campaign.summary()) == lines(printed)
    assert timeless(campaign.save(tmp_path / "many in python")) == timeless(tmp_path / "many")
    assert campaign.estimates().shape == (3, 13) and len(campaign.to_dataframe()) == 6


REFUSED: list[tuple[tuple[object, ...], Callable[[Path, Path], object]]] = [
    (("--model", "rigit"), lambda record, vehicle: fid.identify(record, "rigit", vehicle)),
    (
        ("--model", "rigid", "--method", "ols"),
        lambda record, vehicle: fid.identify(record, "rigid", vehicle, method="ols"),
    ),
    (("--model", "loes"), lambda record, vehicle: fid.identify(record, "loes", vehicle)),
    (
        ("--model", "rigid", "--from", 9),
        lambda record, vehicle: fid.identify(record, "rigid", vehicle, start=9),
    ),
    (
        ("--model", "rigid", "--from", 5, "--to", 2),
        lambda record, vehicle: fid.identify(record, "rigid", vehicle, start=[5], stop=[2]),
    ),
    (
        ("--model", "rigid", "--profile", "CL_x"),
        lambda record, vehicle: fid.identify(record, "rigid", vehicle, profile="CL_x"),
    ),
    (
        ("--model", "rigid", "--validate", "RECORD"),
        lambda record, vehicle: fid.identify(record, "rigid", vehicle, validate=record),
    ),
]


@pytest.mark.parametrize(
    ("options", "call"),
    REFUSED,
    ids=lambda each: " ".join(map(str, each)) if isinstance(each, tuple) else "",
)
def test_a_refusal_is_the_line_of_the_command(
    flightid: CommandLine,
    flight: Path,
    vehicle: Path,
    options: tuple[object, ...],
    call: Callable[[Path, Path], object],
) -> None:
    given = [flight if option == "RECORD" else option for option in options]
    with pytest.raises(fid.InputError) as raised:
        call(flight, vehicle)
    said = flightid.refused("identify", flight, "--vehicle", vehicle, *given)
    assert str(raised.value) == as_keywords(said)


def test_a_channel_map_of_a_call_is_for_all_its_tables(
    table: pandas.DataFrame, vehicle: Path
) -> None:
    other = table.rename(columns={"time": "T", "q": "gyro"}).assign(gyro=np.degrees(table["q"]))
    found = fid.identify(other, "rigid", vehicle, channels={"time": "T", "q": ("gyro", "deg/s")})
    assert found.parameters.to_dict() == pytest.approx(
        fid.identify(table, "rigid", vehicle).parameters.to_dict(), rel=1e-6
    )
    with pytest.raises(
        fid.InputError, match=r"channels, key qq: there is no such key; did you mean 'q'\?"
    ):
        fid.identify(table, "rigid", vehicle, channels={"qq": "q"})


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: fid.run("rigid", seed=-1), "seed: -1 is no seed"),
    (
        lambda: fid.run("rigid", set={"flight.rate": None}),
        "key flight.rate: a NoneType is no value",
    ),
    (lambda: fid.run("rigid", set="flight.rate"), "set=: 'flight.rate' is not key=value"),
    (
        lambda: fid.simulate("rigit"),
        "flightid: there is no scenario 'rigit'; did you mean 'rigid'?",
    ),
    (lambda: fid.campaign("rigid", 1), "runs: 1 runs"),
    (
        lambda: fid.campaign("false-alarms", 9),
        "flightid: false-alarms examines the tracing loop; in a checkout of the source",
    ),
    (
        lambda: fid.campaign("trace-vane", 9),
        "campaign: a campaign of trace-vane examines the tracing loop",
    ),
    (
        lambda: fid.campaign("x29-flight", 9),
        "campaign: there is no campaign of a scenario of kind x29",
    ),
    (lambda: fid.run("standin-one"), "flightid: standin-one examines the tracing loop"),
    (
        lambda: fid.simulate("standin-lateral"),
        "flightid: standin-lateral examines the tracing loop",
    ),
    (lambda: fid.identify([], "rigid"), "records: no record is given"),
    (lambda: fid.identify("r.csv", "rigid", 3), "vehicle: a int is no vehicle"),  # type: ignore[arg-type]
    (
        lambda: fid.identify({"time": [0.0, 1.0]}, "rigid", {}, channels=3),  # type: ignore[arg-type]
        "channels: a int is no channel map",
    ),
    (
        lambda: fid.identify({"time": [0.0, 1.0]}, "rigid", {}, start="12"),  # type: ignore[arg-type]
        "start, stop: '12' is no time",
    ),
    (
        lambda: fid.diagnose({"time": [0.0, 1.0]}, "rigid", {}, effects=3),  # type: ignore[arg-type]
        "effects: a int is no list of effects",
    ),
    (
        lambda: fid.identify({"time": [0.0, 1.0]}, "rigid", {}, band="x"),  # type: ignore[arg-type]
        "band: 'x' is no band; give the lowest and the highest frequency",
    ),
    (
        lambda: fid.identify({"time": [0.0, 1.0]}, "rigid", {}, profile=3),  # type: ignore[arg-type]
        "profile: 3 names no parameter; give a name or a list of names",
    ),
    (
        lambda: fid.predict(3, {"time": [0.0, 1.0]}),  # type: ignore[arg-type]
        "study: a int is no study; give what identify or diagnose returned",
    ),
]


@pytest.mark.parametrize(("call", "line"), WRONG, ids=[line for _, line in WRONG])
def test_what_only_python_can_get_wrong_is_one_line_too(
    call: Callable[[], object], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.csv").write_text("time,alpha\n0,1\n1,2\n")
    with pytest.raises(fid.InputError) as raised:
        call()
    assert (
        str(raised.value).startswith(line) and raised.value.remedy and "\n" not in str(raised.value)
    )


def test_one_table_given_twice_is_refused(table: pandas.DataFrame, vehicle: Path) -> None:
    record = fid.read_record(table, name="flight")
    with pytest.raises(fid.InputError, match=r"flight: the record is named twice"):
        fid.identify([record, record], "rigid", vehicle)
    assert [
        each.name for each in fid.identify([table, table.copy()], "rigid", vehicle).records
    ] == ["record", "record 2"]


def test_a_model_and_an_effect_made_in_python(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs" / "own-models.md").read_text(encoding="utf-8")
    module: dict[str, Any] = {}
    code = text.split("# file: antenna.py\n")[1].split("```")[0]
    exec(code, module)
    (tmp_path / "antenna.py").write_text(code)
    time = np.arange(400) * 0.02
    moved = np.where(time > 1.0, 0.2 * (1.0 - np.cos(time - 1.0)), 0.0)
    columns = {
        "time": time,
        "current": 2.0 * ((time > 1.0) & (time < 3.0)),
        "angle": moved,
        "rate": np.gradient(moved, time),
    }
    in_memory, in_file = (
        fid.identify(fid.read_record(columns, inputs=["current"]), model)
        for model in (module["MODEL"], tmp_path / "antenna.py")
    )
    assert (
        in_memory.parameters.to_dict() == in_file.parameters.to_dict()
        and in_memory.model == "antenna"
    )
    for given, told in (
        (object(), "object"),
        ("input-delay", "str"),
        (object, "object is a class"),
    ):
        with pytest.raises(fid.InputError) as raised:
            fid.diagnose(fid.read_record(columns), module["MODEL"], effects=[given])  # type: ignore[list-item]
        line = str(raised.value)
        assert line.startswith("effects: ") and "lacks" not in line
        assert (told if "class" in told else f"is a {told}, not an effect") in line
