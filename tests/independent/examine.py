"""`flightid diagnose` on folders of flights, each in a process of its own, and how many it told
right.

python -m tests.independent.examine OUT --jobs 2 --aircraft A320 T38
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.independent.grading import Answer, Fault, Grade, Graded, graded, worst_derivative

ROOT = Path(__file__).parents[2]
PATIENCE = 600.0  # s for one diagnosis
FEW_SIGMAS = 3.0  # a derivative that is farther off than this is counted


@dataclass(frozen=True)
class Outcome:
    """One flight: its folder's name, what was put in, the grade, the worst derivative in sigmas,
    and the seconds it took.
    """

    flight: str
    vehicle: str
    fault: str
    graded: Graded
    worst: float
    traced: bool
    seconds: float


def diagnosed(folder: Path, study: Path) -> tuple[Answer, float]:
    """Run the command on the three records of a folder; what it wrote, and the seconds it took. The
    truth file is not among its arguments.
    """
    records = sorted(folder.glob("train*.csv"))
    command = [
        sys.executable,
        "-m",
        "scenarios",
        "diagnose",
        *map(str, records),
        "--model",
        "rigid",
        "--vehicle",
        str(folder / "vehicle.toml"),
    ]
    command += ["--validate", str(folder / "validate.csv"), "--no-figures", "--out", str(study)]
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    begun = time.perf_counter()
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": paths}
    ended = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=environment,
        cwd=study.parent,
        timeout=PATIENCE,
        check=False,
    )
    written = study / "diagnosis.json"
    content: Mapping[str, Any] = (
        json.loads(written.read_text(encoding="utf-8")) if ended.returncode == 0 else {}
    )
    return Answer(
        ended.returncode, content, ended.stderr.strip()[-300:]
    ), time.perf_counter() - begun


def examined(folder: Path, studies: Path) -> Outcome:
    """Diagnose one flight and grade the answer against its truth file."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    faults = [
        Fault(one["name"], frozenset(one["right"]), frozenset(one["twins"]), tuple(one["channels"]))
        for one in truth["faults"]
    ]
    studies.mkdir(parents=True, exist_ok=True)
    answer, seconds = diagnosed(folder, studies / folder.name)
    traced = answer.content.get("verdict") in ("traced", "consistent")
    names = "+".join(fault.name for fault in faults)
    grade = graded(faults, answer)
    if grade.grade is Grade.BROKEN:
        grade = Graded(grade.grade, f"{grade.why}: {answer.said}")
    return Outcome(
        folder.name,
        truth["vehicle"],
        names,
        grade,
        worst_derivative(answer, truth["derivatives"]),
        traced,
        seconds,
    )


def table(outcomes: Sequence[Outcome], key: str) -> str:
    """Counts of grades by an attribute of the outcomes (``fault`` or ``vehicle``), a line each and
    their sum.
    """
    by: dict[str, Counter[Grade]] = {}
    for outcome in outcomes:
        for name in (str(getattr(outcome, key)), "all"):
            by.setdefault(name, Counter())[outcome.graded.grade] += 1
    total = by.pop("all", Counter())
    width = max(map(len, [*by, key, "all"]))
    lines = [f"{key:{width}}  " + "  ".join(f"{grade.value:>7}" for grade in Grade)]
    lines += [
        f"{name:{width}}  " + "  ".join(f"{count[grade]:7d}" for grade in Grade)
        for name, count in [*sorted(by.items()), ("all", total)]
    ]
    return "\n".join(lines)


def summary(outcomes: Sequence[Outcome]) -> str:
    """The tables, and how often a derivative of an explained flight lay too far off."""
    explained = [
        outcome for outcome in outcomes if outcome.traced and outcome.graded.grade is Grade.RIGHT
    ]
    far = sum(outcome.worst > FEW_SIGMAS for outcome in explained)
    slowest = max((outcome.seconds for outcome in outcomes), default=0.0)
    last = (
        f"{far} of {len(explained)} flights told right have a derivative more than "
        f"{FEW_SIGMAS:.0f} sigmas off; the slowest took {slowest:.0f} s"
    )
    return "\n\n".join([table(outcomes, "fault"), table(outcomes, "vehicle"), last])


def line_of(outcome: Outcome) -> str:
    ends = f"worst derivative {outcome.worst:.1f} sigmas, {outcome.seconds:.0f} s"
    return f"{outcome.graded.grade.value:8} {outcome.flight:34} {outcome.graded.why:50} {ends}"


def chosen(out: Path, vehicles: Sequence[str] | None, faults: Sequence[str] | None) -> list[Path]:
    """Folders of flights below ``out``, those of some vehicles and faults only if asked."""
    found = []
    for truth in sorted(out.glob("*/truth.json")):
        content = json.loads(truth.read_text(encoding="utf-8"))
        names = {one["name"] for one in content["faults"]}
        if (vehicles is None or content["vehicle"] in vehicles) and (
            faults is None or names <= set(faults)
        ):
            found.append(truth.parent)
    return found


def main(arguments: Sequence[str] | None = None) -> list[Outcome]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="the folder that holds the flights")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--aircraft", nargs="+")
    parser.add_argument("--fault", nargs="+")
    parser.add_argument(
        "--studies", type=Path, help="where the studies go; else beside the flights"
    )
    parser.add_argument(
        "--counts", action="store_true", help="counts by fault alone, no flight by name"
    )
    given = parser.parse_args(arguments)
    folders = chosen(given.out, given.aircraft, given.fault)
    studies = (given.studies or given.out / "studies").resolve()
    outcomes: list[Outcome] = []
    with concurrent.futures.ThreadPoolExecutor(given.jobs) as pool:
        for outcome in pool.map(lambda folder: examined(folder.resolve(), studies), folders):
            outcomes.append(outcome)
            if not given.counts:
                print(line_of(outcome), flush=True)
    print(table(outcomes, "fault") if given.counts else summary(outcomes))
    return outcomes


if __name__ == "__main__":
    main()
