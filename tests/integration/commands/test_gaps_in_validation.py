"""A record that is predicted: each part between gaps by itself, wild points set aside; the error is
that of the sound record."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.model import Noise
from sim.maneuvers import doublet, sequence, three_two_one_one
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times
from tests.integration.command_line import VEHICLE, CommandLine

NOISE = {"alpha": 5e-4, "q": 5e-4, "nz": 2e-3}
RATE = 20.0
CLOSE = 0.04  # of the error of the sound record; that of 1200 samples scatters by 2 %
WILD = {"alpha": (333, 0.3), "q": (700, -0.5), "nz": (150, 40.0)}
KINDS = ("sound", "gap", "scrap", "spike", "both")


def flown(folder: Path, seed: int, maneuvers: int) -> Record:
    """A rigid aircraft's record at 20 Hz: a 3-2-1-1 and doublets every ten seconds, one of them in
    the gap."""
    model = model_of_file(read_vehicle(folder / "vehicle.toml", "rigid")).with_noise(Noise(NOISE))
    some = [three_two_one_one(0.03, 1.0), *(doublet(0.03, 1.5) for _ in range(maneuvers))]
    return fly(
        model,
        sequence(some, 3.0, start=2.0),
        sample_times(RATE, 60.0),
        np.random.default_rng(seed),
        step=0.01,
        outputs=list(NOISE),
    )[0]


def less(record: Record, *spans: tuple[float, float]) -> Record:
    """The record without the rows of some spans, s."""
    kept = np.ones(len(record), dtype=bool)
    for start, stop in spans:
        kept &= (record.time < start) | (record.time > stop)

    def of(channel: Channel) -> Channel:
        return Channel.of(channel.name, channel.unit, channel.values[kept])

    return Record(
        record.time[kept],
        tuple(map(of, record.inputs)),
        tuple(map(of, record.outputs)),
        record.hold,
        record.name,
    )


def spoiled(record: Record) -> Record:
    """The record with three wild points, far beyond the noise and one within the motion's own
    range."""
    outputs = []
    for channel in record.outputs:
        values = channel.values.copy()
        at, size = WILD[channel.name]
        values[at] += size
        outputs.append(Channel.of(channel.name, channel.unit, values))
    return Record(record.time, record.inputs, tuple(outputs), record.hold, record.name)


def lost(record: Record) -> Record:
    """The record without a sample of q after its gap."""
    values = np.where(record.time > 20.0, np.nan, record["q"].values)
    outputs = tuple(
        Channel.of("q", "rad/s", values) if each.name == "q" else each for each in record.outputs
    )
    return Record(record.time, record.inputs, outputs, record.hold, record.name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record to fit, ``sound.csv`` to predict, and the same with a gap, with a gap and a scrap of
    rows in it, with wild points, with both."""
    made = tmp_path_factory.mktemp("gaps")
    (made / "vehicle.toml").write_text(VEHICLE)
    write_record(made, flown(made, 1, 5), "train")
    sound = flown(made, 2, 6)
    gap = less(sound, (18.01, 26.02))
    forms = {
        "sound": sound,
        "gap": gap,
        "scrap": less(sound, (18.01, 21.98), (22.51, 26.02)),
        "spike": spoiled(sound),
    }
    forms["lost"] = lost(gap)
    forms["both"] = less(spoiled(sound), (18.01, 26.02))
    # what moves in the gap would be missed by a simulation through it
    assert float(np.ptp(sound["elevator"].values[361:521])) > 0.05
    for name, record in forms.items():
        write_record(made, record, name)
    return made


def written(
    flightid: CommandLine, document: str, out: Path, command: str, *options: object
) -> dict[str, Any]:
    """What a command writes."""
    flightid.done(command, *options, "--no-figures", "--out", out)
    content: dict[str, Any] = json.loads((out / document).read_text())
    return content


def same(errors: dict[str, dict[str, float]]) -> None:
    """The errors of every kind are those of the sound record."""
    assert set(errors) == set(KINDS)
    for kind, found in errors.items():
        for name, error in errors["sound"].items():
            assert found[name] == pytest.approx(error, rel=CLOSE), (kind, name)
            assert found[name] == pytest.approx(NOISE[name], rel=0.1), (kind, name)


@pytest.mark.long
def test_identify_predicts_each_part_and_pools_the_errors(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    errors = {}
    for kind in KINDS:
        validate = ["--model", "rigid", "--validate", folder / f"{kind}.csv"]
        content = written(
            flightid,
            "comparison.json",
            tmp_path / kind,
            "identify",
            folder / "train.csv",
            *validate,
        )
        (held,) = [fit for fit in content["records_fitted"] if fit["held_out"]]
        assert held["record"] == f"{kind}.csv"
        errors[kind] = {name: row["rms_error"] for name, row in held["channels"].items()}
        said = json.dumps(content)
        assert ("predicted in 2 parts; initial states and biases are fitted to each" in said) is (
            kind in ("gap", "scrap", "both")
        )
        assert ("has 1 wild point" in said) is (kind in ("spike", "both"))
    same(errors)


@pytest.mark.long
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_predict_predicts_each_part_and_pools_the_errors(
    flightid: CommandLine, folder: Path, tmp_path: Path, command: str
) -> None:
    document = {"identify": "comparison.json", "diagnose": "diagnosis.json"}[command]
    written(
        flightid, document, tmp_path / "study", command, folder / "train.csv", "--model", "rigid"
    )
    errors = {}
    for kind in KINDS:
        content = written(
            flightid,
            "prediction.json",
            tmp_path / kind,
            "predict",
            tmp_path / "study",
            folder / f"{kind}.csv",
        )
        errors[kind] = {name: row["rms_error"] for name, row in content["channels"].items()}
        assert any("wild point" in warning for warning in content["warnings"]) is (
            kind in ("spike", "both")
        )
        assert any("predicted in 2 parts" in note for note in content["notes"]) is (
            kind in ("gap", "scrap", "both")
        )
    same(errors)


def test_a_part_of_a_record_with_a_gap_is_predicted(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    written(
        flightid,
        "comparison.json",
        tmp_path / "study",
        "identify",
        folder / "train.csv",
        "--model",
        "rigid",
    )
    part = ["--from", "10", "--to", "50"]
    some = [
        written(
            flightid,
            "prediction.json",
            tmp_path / kind,
            "predict",
            tmp_path / "study",
            folder / f"{kind}.csv",
            *part,
        )
        for kind in KINDS[:2]
    ]
    for name in NOISE:
        assert some[1]["channels"][name]["rms_error"] == pytest.approx(
            some[0]["channels"][name]["rms_error"], rel=0.06
        )


@pytest.mark.long
def test_diagnose_predicts_each_part_and_writes_every_row(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    errors = {}
    for kind in KINDS:
        validate = ["--model", "rigid", "--validate", folder / f"{kind}.csv"]
        content = written(
            flightid, "diagnosis.json", tmp_path / kind, "diagnose", folder / "train.csv", *validate
        )
        assert content["verdict"] == "consistent", kind
        errors[kind] = content["error"]["after"]["rmse"]
        header, *rows = csv.reader(
            (tmp_path / kind / "validate_prediction.csv").read_text().splitlines()
        )
        recorded = list(csv.reader((folder / f"{kind}.csv").read_text().splitlines()))[1:]
        assert header == [
            "time",
            *(f"{when}_{name}" for when in ("before", "after") for name in NOISE),
        ]
        assert [float(row[0]) for row in rows] == [float(row[0]) for row in recorded]
        assert all(math.isfinite(float(cell)) for row in rows for cell in row)
        assert not (tmp_path / kind / "validate_prediction_2.csv").exists()
    same(errors)


@pytest.mark.long
def test_a_channel_that_a_part_does_not_have_counts_in_the_others(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    validate = ["--model", "rigid", "--validate", folder / "lost.csv"]
    content = written(
        flightid, "comparison.json", tmp_path / "study", "identify", folder / "train.csv", *validate
    )
    (held,) = [fit for fit in content["records_fitted"] if fit["held_out"]]
    predicted = written(
        flightid,
        "prediction.json",
        tmp_path / "later",
        "predict",
        tmp_path / "study",
        folder / "lost.csv",
    )
    diagnosed = written(
        flightid, "diagnosis.json", tmp_path / "cause", "diagnose", folder / "train.csv", *validate
    )
    for name, noise in NOISE.items():
        for error in (
            held["channels"][name]["rms_error"],
            predicted["channels"][name]["rms_error"],
            diagnosed["error"]["after"]["rmse"][name],
        ):
            assert error == pytest.approx(noise, rel=0.1), name
    cells = [
        cell
        for row in csv.reader(
            (tmp_path / "cause" / "validate_prediction.csv").read_text().splitlines()[1:]
        )
        for cell in row
    ]
    assert all(math.isfinite(float(cell)) for cell in cells)
    fitted = written(
        flightid,
        "comparison.json",
        tmp_path / "fit",
        "identify",
        folder / "lost.csv",
        "--model",
        "rigid",
    )
    assert fitted["parameters"]["Cm_de"]["estimate"] == pytest.approx(
        -2.1, abs=4.0 * fitted["parameters"]["Cm_de"]["std"]
    )
