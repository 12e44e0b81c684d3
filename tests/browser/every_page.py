"""Every kind of page that a command writes, made once in a folder."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

from flightid.labs.workings import model_structure
from scenarios.cli import main

FLIGHTS = """model = "rigid"
vehicle = "flight_vehicle.toml"

[[flights]]
records = ["flight.csv"]

[[flights]]
records = ["flight_validate.csv"]

[[flights]]
records = ["clean.csv"]
"""
MANEUVERS = ("maneuver_1.csv", "maneuver_2.csv", "maneuver_3.csv")
MODEL = ("--model", "rigid", "--vehicle", "flight_vehicle.toml")
# Kind of page -> the command that writes it, in the order in which they need each other.
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "run": ("run", "rigid"),
    "run-filter": ("run", "rigid-process-noise-a"),
    "run-trace": ("run", "trace-pair"),
    "run-loop": ("run", "x29-simulation"),
    "run-sweep": ("run", "uav-sweep"),
    "identify": ("identify", "flight.csv", *MODEL),
    "diagnose": ("diagnose", "flight.csv", *MODEL, "--validate", "flight_validate.csv"),
    "predict": ("predict", "identify", "flight_validate.csv"),
    "check": ("check", "flight.csv", "--vehicle", "flight_vehicle.toml"),
    "maneuvers": ("maneuvers", "flight.csv"),
    "response": ("response", "flight.csv", "--input", "elevator", "--output", "q"),
    "design": ("design", *MODEL),
    "campaign": ("campaign", "rigid", "--runs", "6"),
    "compare": ("compare", "run", "run-filter"),
    "survey": ("survey", "flights.toml"),
    "watch": ("watch", "flight.csv", *MODEL, "--reference", "identify", "--idle", "1"),
    "structure": (
        *("structure", *MANEUVERS, "--vehicle", "vehicle.toml"),
        *("--validate", "not_fitted.csv"),
    ),
}
# What tests look at: all forms of page, each once.
KINDS = tuple(kind for kind in COMMANDS if kind not in ("run-filter", "run-trace"))


def make_pages(folder: Path, kinds: tuple[str, ...] = tuple(COMMANDS)) -> dict[str, Path]:
    """Write the pages of these kinds below a folder, with what they need; page by kind.

    Raises RuntimeError, with what the command printed, where one fails.
    """
    needed = set(kinds)
    needed |= {"identify"} if needed & {"predict", "watch"} else set()
    needed |= {"run", "run-filter"} if "compare" in needed else set()
    folder.mkdir(parents=True, exist_ok=True)
    typed(folder, "simulate", "trace-delay", "--out", "flight.csv")
    typed(folder, "simulate", "trace-nothing", "--out", "clean.csv")
    (folder / "flights.toml").write_text(FLIGHTS, encoding="utf-8")
    if "structure" in needed:
        files = io.BytesIO(model_structure.archive(model_structure.study()))
        with zipfile.ZipFile(files) as packed:
            packed.extractall(folder)
    pages = {}
    for kind, command in COMMANDS.items():
        if kind in needed:
            typed(folder, *command, "--out", kind)
            pages[kind] = folder / kind / "report.html"
    return {kind: pages[kind] for kind in kinds}


def typed(folder: Path, *words: str) -> None:
    """A command as it is typed in the folder; one that finds a doubt ends with 1.

    It runs in this process: a process of its own would spend most of its time on imports.
    """
    printed = io.StringIO()
    code: object = 0
    with chdir(folder), redirect_stdout(printed), redirect_stderr(printed):
        try:
            main([*words])
        except SystemExit as ended:
            code = ended.code
    if code not in (0, 1, None):
        raise RuntimeError(f"flightid {' '.join(words)} ended with {code}:\n{printed.getvalue()}")
