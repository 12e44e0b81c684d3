"""Whole commands: what two processes bring, and how much memory each command takes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.comparison.compare import Pace
from benchmarks.comparison.page import Table, seconds, times
from benchmarks.comparison.timing import quartiles, ratios
from benchmarks.comparison.whole_process import measured

FLIGHTID = [sys.executable, "-m", "scenarios"]
ROOT = Path(__file__).resolve().parents[2]
_RUN = (
    f"import sys; sys.path.insert(0, {str(ROOT)!r}); from exam.__main__ import main; "
    "sys.exit(main())"
)
EXAM = [sys.executable, "-c", _RUN]  # is not installed
# A campaign: its name, its command, its runs, those of a quick benchmark, and rounds.
STUDIES = (
    ("campaign rigid", [*FLIGHTID, "campaign", "rigid", "--quiet"], 10000, 1000, 3),
    ("exam surrogates surrogate-none", [*EXAM, "surrogates", "surrogate-none"], 4, 2, 1),
)
ASKED_RUNS = (1000, 100_000)


def jobs(pace: Pace, folder: Path, say: Callable[[str], None]) -> Table:
    """Campaigns by one process and by two, in turn."""
    rows, data = [], {}
    for name, words, whole, few, rounds in STUDIES:
        if pace.small and name != "campaign rigid":
            continue
        runs = few if pace.small else whole
        say(f"jobs: {name} --runs {runs}, one and two processes")
        found: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(min(rounds, pace.cold_rounds)):
            for count in found:
                command = [*words, "--runs", str(runs), "--jobs", str(count), "--no-figures"]
                found[count].append(measured(command, folder).seconds)
        gain = ratios(found[1], found[2])
        study = f"{name} --runs {runs}"
        rows.append(
            (
                f"`{study}`",
                *(seconds(quartiles(found[count]).median) for count in found),
                times(gain),
            )
        )
        data[study] = {
            "seconds": {str(count): values for count, values in found.items()},
            "gain": gain._asdict(),
        }
    about = """Whole processes with one thread each, start included, on the cores named above.
    Two jobs need both cores: where the load before is not near zero, other work had them, and this table says little."""  # noqa: E501
    return Table(
        "One job and two",
        about,
        ("study", "one job", "two jobs", "times faster"),
        tuple(rows),
        data,
    )


def memory(pace: Pace, folder: Path, say: Callable[[str], None]) -> Table:
    """Peak memory and time of the main commands."""
    files = _flown(folder)
    commands = {
        "Python with NumPy": [sys.executable, "-c", "import numpy"],
        "import flightid": [sys.executable, "-c", "import flightid"],
        "run rigid": [*FLIGHTID, "run", "rigid", "--out", "run"],
        "simulate rigid": [*FLIGHTID, "simulate", "rigid", "--out", "record.csv"],
        "check": [*FLIGHTID, "check", *files[:1], "--vehicle", files[2], "--out", "check"],
        "identify --model rigid": [
            *FLIGHTID,
            "identify",
            files[0],
            "--model",
            "rigid",
            "--vehicle",
            files[2],
            "--out",
            "identify",
        ],
        "diagnose --model rigid": [
            *FLIGHTID,
            "diagnose",
            files[0],
            "--model",
            "rigid",
            "--vehicle",
            files[2],
            "--validate",
            files[1],
            "--out",
            "diagnose",
        ],
    }
    for runs in ASKED_RUNS[:1] if pace.small else ASKED_RUNS:
        commands[f"campaign rigid --runs {runs} --jobs 1"] = [
            *FLIGHTID,
            "campaign",
            "rigid",
            "--runs",
            str(runs),
            "--jobs",
            "1",
            "--quiet",
        ]
    found = {}
    for name, command in commands.items():
        say(f"memory: {name}")
        found[name] = measured(command, folder)
    rows = tuple(
        (f"`{name}`", f"{each.memory:.0f}", seconds(each.seconds)) for name, each in found.items()
    )
    about = (
        "Peak resident memory of the process, or of its largest child, and how long it took, "
        "start, figures and report included."
    )
    return Table(
        "Memory",
        about,
        ("command", "MiB", "time"),
        rows,
        {name: each._asdict() for name, each in found.items()},
    )


def _flown(folder: Path) -> list[str]:
    """Record, held-out record and vehicle file of the scenario `trace-delay`: 1001 samples of three
    channels.
    """
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated

    scenario = trace_scenario_of(*load_document("trace-delay"))
    return [str(path) for path in write_simulated(fly_trace(scenario, scenario.seed), folder)]
