"""600 malformed calls by their numbers: the number is the seed of what is spoiled and how."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.fuzz.material import Material
from tests.fuzz.mutations import (
    CONTROL,
    EXTREMES,
    UNITS,
    spoiled_json,
    spoiled_model,
    spoiled_table,
    spoiled_toml,
)

COUNT = 600
Kind = Callable[[Material, Path, random.Random], list[str]]
FIGURES = ["--figures", "none"]


def case(number: int, material: Material, folder: Path) -> list[str]:
    """The arguments of a malformed call; its files are written into ``folder``, which becomes the
    current one.
    """
    draw = random.Random(number)
    return KINDS[number % len(KINDS)](material, folder, draw)


def _take(material: Material, folder: Path, *names: str) -> None:
    for name in names:
        source = material.folder / name
        shutil.copytree(source, folder / name) if source.is_dir() else shutil.copy(
            source, folder / name
        )


def _record(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled record in a command that reads one."""
    name = draw.choice(
        (
            "flight.csv",
            "flight.csv",
            "flight.csv.gz",
            "flight.mat",
            "flight.parquet",
            f"fl{CONTROL}ight.csv",
        )
    )
    calls: Sequence[Callable[[], list[str]]] = (
        lambda: [
            "identify",
            name,
            "--model",
            "rigid",
            "--vehicle",
            "vehicle.toml",
            "--method",
            draw.choice(METHODS),
        ],
        lambda: [
            "identify",
            name,
            "--model",
            "rigid",
            "--vehicle",
            "vehicle.toml",
            "--method",
            "equation-error",
        ],
        lambda: [
            "identify",
            name,
            "rigid.csv",
            "--model",
            "rigid",
            "--vehicle",
            "vehicle.toml",
            "--out",
            "found",
            *FIGURES,
        ],
        lambda: ["check", name, "--vehicle", "vehicle.toml"],
        lambda: ["diagnose", name, "--model", "rigid", "--vehicle", "vehicle.toml"],
        lambda: ["predict", "fit", name],
        lambda: ["survey", "flights.toml", "--jobs", "1", "--out", "morning", *FIGURES],
    )
    call = draw.choice(calls)()
    _take(material, folder, "vehicle.toml", "rigid.csv", "rigid.json")
    if call[0] == "predict":
        _take(material, folder, "fit")
    if call[0] == "survey":
        (folder / "flights.toml").write_text(
            material.text("flights.toml").replace("second.csv", name.replace(CONTROL, "")),
            encoding="utf-8",
        )
    spoiled = spoiled_table(material.text("rigid.csv"), draw)
    (folder / (name.replace(CONTROL, "") if call[0] == "survey" else name)).write_bytes(spoiled)
    return call


METHODS = ("ekf", "ukf", "output-error", "filter-error", "equation-error", "frequency-domain")


def _own_record(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled record of a user's own model."""
    _take(material, folder, "roll.py")
    (folder / "flight.csv").write_bytes(spoiled_table(material.text("roll.csv"), draw))
    return ["identify", "flight.csv", "--model", "roll.py", "--method", draw.choice(METHODS)]


def _stream(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled stream, or a spoiled study to compare it with."""
    call = ["watch", "stream.csv", "--model", "loes", "--until-end", "--no-refine"]
    if draw.random() < 0.5:
        (folder / "stream.csv").write_bytes(spoiled_table(material.text("stream.csv"), draw))
        return call
    _take(material, folder, "stream.csv", "watched")
    (folder / "watched" / "comparison.json").write_bytes(
        spoiled_json(material.text("watched/comparison.json"), draw)
    )
    return [*call, "--reference", "watched"]


def _toml(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled vehicle file, channel map, file of limits or file of flights."""
    _take(material, folder, "vehicle.toml", "rigid.csv", "rigid.json", "second.csv", "second.json")
    reading = ["--model", "rigid", "--vehicle", "vehicle.toml"]
    file, call = draw.choice(
        (
            ("vehicle.toml", ["identify", "rigid.csv", *reading, "--method", draw.choice(METHODS)]),
            ("vehicle.toml", ["identify", "rigid.csv", *reading, "--method", "equation-error"]),
            ("vehicle.toml", ["check", "rigid.csv", "--vehicle", "vehicle.toml"]),
            ("vehicle.toml", ["diagnose", "rigid.csv", *reading]),
            ("vehicle.toml", ["design", *reading, "--duration", "8", "--rate", "10"]),
            (
                "channels.toml",
                [
                    "identify",
                    "rigid.csv",
                    *reading,
                    "--channels",
                    "channels.toml",
                    "--method",
                    "equation-error",
                ],
            ),
            (
                "limits.toml",
                ["design", *reading, "--limits", "limits.toml", "--duration", "8", "--rate", "10"],
            ),
            (
                "flights.toml",
                ["survey", "flights.toml", "--jobs", "1", "--out", "morning", *FIGURES],
            ),
        )
    )
    (folder / file).write_bytes(spoiled_toml(material.text(file), draw))
    return call


def _study(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled file of a study in a command that reads studies."""
    study, file, call = draw.choice(
        (
            ("fit", "report.json", ["report", "fit"]),
            ("cause", "report.json", ["report", "cause"]),
            ("study", "report.json", ["report", "study"]),
            ("fit", "model.json", ["predict", "fit", "second.csv"]),
            ("fit", "model.json", ["predict", "fit", "second.csv", "--out", "predicted", *FIGURES]),
            ("cause", "model.json", ["predict", "cause", "second.csv"]),
            ("fit", "comparison.json", ["compare", "fit", "study"]),
            (
                "study",
                "comparison.json",
                ["compare", "fit", "study", "--methods", "--out", "compared", *FIGURES],
            ),
            ("cause", "diagnosis.json", ["compare", "fit", "cause", "--methods"]),
            ("study", "record.json", ["compare", "fit", "study", "--out", "compared", *FIGURES]),
        )
    )
    _take(
        material,
        folder,
        *dict.fromkeys(("fit", study, *(("study",) if call[0] == "compare" else ()))),
        "second.csv",
        "second.json",
    )
    (folder / study / file).write_bytes(spoiled_json(material.text(f"{study}/{file}"), draw))
    return call


def _sidecar(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A spoiled JSON beside a record."""
    _take(material, folder, "vehicle.toml", "rigid.csv")
    (folder / "rigid.json").write_bytes(spoiled_json(material.text("rigid.json"), draw))
    return [
        "identify",
        "rigid.csv",
        "--model",
        "rigid",
        "--vehicle",
        "vehicle.toml",
        "--method",
        "equation-error",
    ]


def _model(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A user's model that fails somewhere."""
    _take(material, folder, "roll.csv", "roll.json")
    (folder / "roll.py").write_bytes(spoiled_model(material.text("roll.py"), draw))
    calls = (
        ["models", "roll.py"],
        [
            "identify",
            "roll.csv",
            "--model",
            "roll.py",
            "--method",
            draw.choice(METHODS),
            "--out",
            "found",
            *FIGURES,
        ],
        ["identify", "roll.csv", "--model", "roll.py", "--method", "output-error"],
        [
            "simulate",
            "--model",
            "roll.py",
            "--out",
            "flight.csv",
            "--duration",
            "5",
            "--rate",
            "20",
        ],
        ["diagnose", "roll.csv", "--model", "roll.py"],
        [
            "campaign",
            "--model",
            "roll.py",
            "--runs",
            "2",
            "--duration",
            "5",
            "--rate",
            "20",
            "--jobs",
            "1",
        ],
        ["design", "--model", "roll.py", "--duration", "5", "--rate", "10"],
    )
    return draw.choice(calls)


COUNTS = (
    "0",
    "-1",
    "1",
    str(10**18),
    str(10**30),
    "9" * 5000,
    "1e3",
    "٣",
    "１０",
    "1_000",
    "0x10",
    "nan",
    "",
    " ",
    "99999999999",
)
REALS = (
    "1e-9",
    "1e308",
    "-1e308",
    "1e-300",
    "0",
    "-1",
    "nan",
    "inf",
    "-inf",
    "٣",
    "１.５",
    "1_0.0",
    "1e400",
    "",
    "9" * 5000,
    "1e15",
    "5e-324",
)


def _option(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """An option with a value that is no sensible one."""
    _take(material, folder, "vehicle.toml", "rigid.csv", "rigid.json", "roll.py")
    count, real = draw.choice(COUNTS), draw.choice(REALS)
    fitting = [
        "identify",
        "rigid.csv",
        "--model",
        "rigid",
        "--vehicle",
        "vehicle.toml",
        "--method",
        draw.choice(("equation-error", "output-error")),
    ]
    flying = ["simulate", "--model", "roll.py", "--out", "flight.csv"]
    planning = [
        "design",
        "--model",
        "rigid",
        "--vehicle",
        "vehicle.toml",
        "--rate",
        "10",
        "--duration",
        "8",
    ]
    key = draw.choice(
        (
            "flight.rate",
            "flight.duration",
            "flight.maneuvers.1.amplitude",
            "estimate.start.CL_q.value",
            "estimate.terms",
            "seed",
            "title",
            "x" * 9999,
        )
    )
    value = draw.choice(
        (
            *EXTREMES,
            *REALS,
            "[" * 10_000,
            '"1 ' + draw.choice(UNITS) + '"',
            CONTROL,
            "{}",
            "[]",
            "true",
        )
    )
    calls = (
        ["campaign", "rigid", "--runs", count, "--jobs", "1"],
        ["campaign", "rigid", "--runs", "2", "--jobs", count],
        ["campaign", "rigid", "--runs", "2", "--seed", count, "--jobs", "1"],
        ["campaign", "rigid", "--runs", "2", "--time-limit", real, "--jobs", "1"],
        ["run", "rigid", "--seed", count],
        ["run", "rigid", "--set", f"{key}={value}"],
        ["run", draw.choice((CONTROL, "٣", "../rigid", "x" * 9999, "", "rigid\0"))],
        ["simulate", "rigid", "--seed", count, "--out", "flight.csv"],
        ["simulate", "rigid", "--set", f"{key}={value}", "--out", "flight.csv"],
        [*flying, "--rate", real],
        [*flying, "--duration", real],
        [*flying, "--noise", f"p={real}"],
        [*flying, "--input", f"aileron=doublet,amplitude={real},start=1,unit=1"],
        [*fitting, "--from", real],
        [*fitting, "--to", real],
        [*fitting, "--rate", real],
        [*fitting, "--lowpass", real],
        [*fitting, "--band", real, "2"],
        ["check", "rigid.csv", "--vehicle", "vehicle.toml", draw.choice(("--from", "--to")), real],
        [
            "diagnose",
            "rigid.csv",
            "--model",
            "rigid",
            "--vehicle",
            "vehicle.toml",
            draw.choice(("--rate", "--lowpass", "--from", "--to")),
            real,
        ],
        [*planning, draw.choice(("--duration", "--rate")), real],
        [*planning, "--noise", f"alpha={draw.choice((real, CONTROL, '1 ' + draw.choice(UNITS)))}"],
        [*planning, "--amplitude", f"elevator={draw.choice((real, '1 ' + draw.choice(UNITS)))}"],
        [*planning, "--value", f"Cm_q={real}"],
        ["models", draw.choice((CONTROL, "x" * 300, "no.py", "/dev/null", "/"))],
        ["vehicles", draw.choice((CONTROL, "x" * 9999, "", "/dev/zero"))],
        ["effects", draw.choice((CONTROL, "x" * 9999, ""))],
        ["watch", "rigid.csv", "--model", "loes", "--until-end", "--idle", real],
        ["lab", count],
    )
    return [text.replace("\0", "") for text in draw.choice(calls)]


def _place(material: Material, folder: Path, draw: random.Random) -> list[str]:
    """A path that is none: too long, a circle of links, a device, a pipe, a folder, a file where a
    folder must be.
    """
    _take(material, folder, "vehicle.toml", "rigid.csv", "rigid.json", "fit", "study")
    os.symlink("circle", folder / "circle")
    os.symlink("there", folder / "back")
    os.symlink("back", folder / "there")
    os.mkfifo(folder / "pipe.csv")
    with (folder / "sparse.csv").open("wb") as sparse:
        sparse.truncate(1 << 40)
    (folder / "theirs.json").write_text('{"mine": 1}', encoding="utf-8")
    out = draw.choice(
        (
            "x" * 300,
            "circle",
            "circle/x",
            "there/y",
            "/dev/null",
            "/dev/full",
            "/dev/null/x",
            "rigid.csv",
            "rigid.csv/x",
            "/proc/1/x",
            "a/" * 3000,
        )
    )
    path = draw.choice(
        (
            "x" * 300,
            "circle",
            "there/rigid.csv",
            "/dev/zero",
            "/dev/full",
            "pipe.csv",
            "sparse.csv",
            ".",
            "/",
            "/dev/null",
            "rigid.csv/x",
            "/proc/self/mem",
            "",
        )
    )
    reading = ["--model", "rigid", "--vehicle", "vehicle.toml"]
    calls = (
        ["run", "rigid", "--out", out, *FIGURES],
        ["identify", "rigid.csv", *reading, "--method", "equation-error", "--out", out, *FIGURES],
        ["simulate", "rigid", "--out", out],
        ["simulate", "rigid", "--out", "theirs.csv"],
        ["compare", "fit", "study", "--out", out, *FIGURES],
        ["check", "rigid.csv", "--vehicle", "vehicle.toml", "--out", out, *FIGURES],
        ["design", *reading, "--duration", "8", "--rate", "10", "--out", out, *FIGURES],
        ["campaign", "rigid", "--runs", "2", "--jobs", "1", "--out", out, *FIGURES],
        ["predict", "fit", "rigid.csv", "--out", out, *FIGURES],
        ["identify", path, *reading],
        ["identify", "rigid.csv", "--model", "rigid", "--vehicle", path],
        ["identify", "rigid.csv", *reading, "--channels", path],
        ["check", path],
        ["diagnose", path, *reading],
        ["predict", path, "rigid.csv"],
        ["predict", "fit", path],
        ["report", path],
        ["compare", "fit", path],
        ["watch", path, "--model", "loes", "--until-end"],
        ["watch", "rigid.csv", "--model", "loes", "--until-end", "--reference", path],
        ["survey", path, "--out", "morning"],
        ["models", path],
        ["design", "--model", "rigid", "--vehicle", path],
    )
    return draw.choice(calls)


# Several times what has most ways of being wrong.
KINDS: tuple[Kind, ...] = (
    _record,
    _toml,
    _study,
    _option,
    _model,
    _record,
    _toml,
    _study,
    _option,
    _place,
    _own_record,
    _stream,
    _study,
    _option,
    _sidecar,
)
