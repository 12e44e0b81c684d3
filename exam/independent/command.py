"""`python -m exam independent`: fly the 120 flights, have them diagnosed from files alone, and
grade the answers.
"""

from __future__ import annotations

import concurrent.futures
import csv
import json
import os
import shlex
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exam.independent.grading import (
    FEW_SIGMAS,
    Answer,
    Grade,
    grade,
    held_out,
    predictable,
    said_with,
    sizes,
)
from exam.scoring import share_of_flights

ROOT = Path(__file__).parents[2]
PATIENCE = 1800.0  # s, longest time of a diagnosis
FIELDS = (
    "flight",
    "model",
    "aircraft",
    "hidden",
    "grade",
    "answer",
    "sizes",
    "probabilities",
    "before",
    "after",
    "predictable",
    "seconds",
)
RELIABILITY = ((0.0, 0.5), (0.5, 0.95), (0.95, 1.01))  # bins of the probabilities of names
NOTHING = "nothing"  # label of a clean flight
MOST_ERROR = 1.1  # largest good error on the held-out record, relative to the noise
SIMULATORS, HALVES = ("jsbsim", "own"), ("tuning", "kept")


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, diagnose and grade; return 2 with one line for an invalid request."""
    asked = _parser().parse_args(arguments)
    if asked.out is None or (asked.score is None and None in (asked.set, asked.simulator)):
        remedy = "give --out with --set and --simulator, or with --score DIR"
        print(f"python -m exam independent: not enough is said; {remedy}", file=sys.stderr)
        return 2
    if asked.only and not all(each.strip().isdigit() for each in asked.only.split(",")):
        print(
            f"python -m exam independent: --only {asked.only}: give numbers with commas",
            file=sys.stderr,
        )
        return 2
    folders = _existing(asked) if asked.score else _flown(asked)
    if not folders:
        where = asked.score or asked.out
        print(
            f"python -m exam independent: no flights in {where}; check the folder and --only",
            file=sys.stderr,
        )
        return 2
    if asked.fly_only:
        return 0
    answers = asked.out.resolve() / "answers"
    answers.mkdir(parents=True, exist_ok=True)
    command = shlex.split(asked.command) if asked.command else [sys.executable, "-m", "scenarios"]
    rows = []
    with concurrent.futures.ThreadPoolExecutor(asked.jobs) as pool:
        for row in pool.map(lambda folder: row_of(folder, answers / folder.name, command), folders):
            rows.append(row)
            print(_line(row), flush=True)
            _write(answers.parent / "flights.csv", rows)
    print(summary(rows))
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="python -m exam independent",
        description="independent flights, diagnosed from files alone and graded",
    )
    parser.add_argument(
        "--set", choices=HALVES, help="which half: for whoever tunes, or kept from them"
    )
    parser.add_argument("--simulator", choices=SIMULATORS)
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for flights and answers; with --score for the answers alone",
    )
    parser.add_argument("--jobs", type=int, default=1, help="diagnoses at a time")
    parser.add_argument(
        "--draw", type=int, default=0, help="other aircraft and sizes for the same causes"
    )
    parser.add_argument("--only", help="numbers of flights, with commas")
    parser.add_argument("--fly-only", action="store_true", help="write the folders and stop")
    parser.add_argument(
        "--score",
        type=Path,
        metavar="DIR",
        help="grade the flights of a folder; answers already in --out are kept",
    )
    parser.add_argument("--command", help="the command to examine; else this checkout's")
    return parser


def _wanted(asked: Namespace, number: int) -> bool:
    return not asked.only or number in {int(each) for each in asked.only.split(",")}


def _existing(asked: Namespace) -> list[Path]:
    found = sorted(path.parent for path in asked.score.glob("[0-9]*/truth.json"))
    return [folder.resolve() for folder in found if _wanted(asked, int(folder.name))]


def _flown(asked: Namespace) -> list[Path]:
    """Fly half of the flights of one simulator into the folder."""
    fly: Callable[[int, Path, int], None]
    if asked.simulator == "jsbsim":
        from exam.independent import jsbsim_flights

        fly, count = jsbsim_flights.fly_flight, jsbsim_flights.COUNT
    else:
        from exam.independent import own_flights

        fly, count = own_flights.fly_flight, own_flights.COUNT
    folders = []
    for number in range(2 if asked.set == "tuning" else 1, count + 1, 2):
        if _wanted(asked, number):
            folders.append((asked.out / f"{number:03d}").resolve())
            fly(number, folders[-1], asked.draw)
    return folders


def diagnosed(folder: Path, study: Path, command: Sequence[str], model: str) -> Answer:
    """Run `diagnose` in a process of its own on the files of a flight, unless its answer exists."""
    kept = study.with_suffix(".json")
    if not kept.exists():
        trains = sorted(map(str, folder.glob("train-*.csv")))
        given = {"--model": model, "--vehicle": folder / "vehicle.toml"}
        given |= {"--validate": folder / "validate.csv", "--out": study}
        line = [*command, "diagnose", *trains, "--no-figures", "--quiet"]
        line += [str(word) for option in given.items() for word in option]
        code, said, seconds = _run(line, study.parent)
        ended = {"code": code, "said": said, "seconds": seconds}
        kept.write_text(json.dumps(ended), encoding="utf-8", newline="\n")
    ended = json.loads(kept.read_text(encoding="utf-8"))
    written = study / "diagnosis.json"
    content: dict[str, Any] = (
        json.loads(written.read_text(encoding="utf-8"))
        if ended["code"] == 0 and written.exists()
        else {}
    )
    return Answer(ended["code"], content, ended["said"], ended["seconds"])


def _run(line: Sequence[str], where: Path) -> tuple[int, str, float]:
    """Return exit code, end of the error stream and processor seconds of a command; a command that
    takes longer than ``PATIENCE`` is stopped.
    """
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = paths
    errors = where / f"{Path(line[-1]).name}.err"
    with errors.open("w", encoding="utf-8", newline="\n") as stream:
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(line, stdout=quiet, stderr=stream, env=environment, cwd=where)
        code, seconds = _waited(process)
    return code, errors.read_text(encoding="utf-8", errors="replace").strip()[-300:], seconds


def _waited(process: subprocess.Popen[bytes]) -> tuple[int, float]:
    """Return exit code and processor seconds, including children; NaN seconds if they are
    unknown.
    """
    if not hasattr(os, "wait4"):
        try:
            return process.wait(PATIENCE), float("nan")
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait(), float("nan")
    begun = time.monotonic()
    while True:
        done, status, usage = os.wait4(process.pid, os.WNOHANG)
        if done:
            process.returncode = os.waitstatus_to_exitcode(status)
            return process.returncode, usage.ru_utime + usage.ru_stime
        if time.monotonic() - begun > PATIENCE:
            process.kill()
        time.sleep(0.1)


def row_of(folder: Path, study: Path, command: Sequence[str]) -> dict[str, Any]:
    """Diagnose one flight and grade the answer by its truth file. Return a row of ``flights.csv``,
    with the grade and its reason.
    """
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    answer = diagnosed(folder, study, command, truth["model"])
    found, why = grade(truth, answer)
    return {
        "flight": folder.name,
        "model": truth["model"],
        "aircraft": truth["aircraft"],
        "hidden": " + ".join(truth["hidden"]) or NOTHING,
        "grade": found.value,
        "answer": why,
        "sizes": " ".join(f"{distance:.2f}" for distance in sizes(truth, answer)),
        "probabilities": " ".join(
            f"{share:.3f}:{'right' if right else 'wrong'}"
            for share, right in said_with(truth, answer)
        ),
        "before": held_out(folder, study, truth, "before"),
        "after": held_out(folder, study, truth),
        "predictable": predictable(truth),
        "seconds": answer.seconds,
    }


def _line(row: dict[str, Any]) -> str:
    head = f"{row['flight']} {row['model']:12} {row['hidden']:34.34} {row['grade']:11}"
    error = f"{row['before']:5.2f} -> {row['after']:5.2f}"
    return f"{head} {row['answer']:60.60} {error} {row['seconds']:5.0f} s"


def _write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        writer.writerows(rows)


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Return grades by model, shares with exact intervals, sizes within three sigmas, held-out
    error, and processor seconds.
    """
    groups: dict[str, Counter[str]] = {}
    for row in rows:
        for name in (f"{row['model']} {'clean' if _clean(row) else 'planted'}", "all"):
            groups.setdefault(name, Counter())[row["grade"]] += 1
    head = f"{'':22}" + "".join(f"{each.value:>12}" for each in Grade)
    order = sorted(groups, key=lambda name: (name == "all", name))
    lines = [
        head,
        *(
            f"{name:22}" + "".join(f"{groups[name][each.value]:12d}" for each in Grade)
            for name in order
        ),
    ]
    unexplained = Grade.ALARM.value
    lines += [
        _share("Right", [row["grade"] == Grade.RIGHT.value for row in rows]),
        _share(
            "Right where a cause is planted",
            [row["grade"] == Grade.RIGHT.value for row in rows if not _clean(row)],
        ),
        _share("Wrong names", [row["grade"] == Grade.WRONG.value for row in rows]),
        _share(
            "False alarms among clean flights",
            [row["grade"] == unexplained for row in rows if _clean(row)],
        ),
    ]
    distances = [abs(float(each)) for row in rows for each in row["sizes"].split()]
    lines.append(
        _share(
            f"Claimed sizes within {FEW_SIGMAS:.0f} sigmas",
            [each <= FEW_SIGMAS for each in distances],
        )
    )
    said = [each.split(":") for row in rows for each in row["probabilities"].split()]
    for low, high in RELIABILITY:
        hits = [right == "right" for share, right in said if low <= float(share) < high]
        lines.append(_share(f"Names said with {low:.0%} to {min(high, 1.0):.0%}, right", hits))
    within = [row["after"] <= MOST_ERROR for row in rows if row["predictable"] and not _clean(row)]
    lines.append(
        _share(f"Held-out error at most {MOST_ERROR} times the noise, cause in the library", within)
    )
    seconds = [row["seconds"] for row in rows if np.isfinite(row["seconds"])]
    if seconds:
        lines.append(
            f"Processor seconds: median {np.median(seconds):.1f}, largest {max(seconds):.1f}"
        )
    return "\n".join(lines)


def _clean(row: dict[str, Any]) -> bool:
    return bool(row["hidden"] == NOTHING)


def _share(what: str, hits: Sequence[bool]) -> str:
    if not hits:
        return f"{what}: none to count"
    share = share_of_flights(hits)
    low, high = share.interval
    percent = f"{100 * share.count / share.of:.0f} %, {100 * low:.0f} to {100 * high:.0f} %"
    return f"{what}: {share.count} of {share.of} ({percent})"
