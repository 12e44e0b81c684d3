"""Whether two checkouts give the same numbers: commands with fixed seeds run by both.

    python benchmarks/same_numbers.py OLD [--only NAME,...] [--keep DIR]

OLD is another checkout of the source. Every number of the JSON documents and CSV files must agree
to 1e-9, every other word exactly. Exit code 1 where anything differs.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TOLERANCE = 1e-9  # relative, and absolute below one
FIRST = "flight.csv --model rigid --vehicle flight_vehicle.toml"
# Commands by name, run in one folder in this order; the last word of some is a folder that is read.
COMMANDS = {
    "simulate": "simulate trace-delay --seed 7 --out flight.csv",
    "rigid": "run rigid --seed 1 --no-figures --out rigid",
    "lateral": "run lateral --seed 1 --no-figures --out lateral",
    "longitudinal": "run longitudinal --seed 1 --no-figures --out longitudinal",
    "ballistic": "run ballistic --seed 1 --no-figures --out ballistic",
    "own-model": "run own-model --seed 1 --no-figures --out own-model",
    "x29": "run x29-flight --seed 1 --no-figures --out x29",
    "unstable": "run unstable --seed 1 --no-figures --out unstable",
    "trace-nothing": "run trace-nothing --seed 1 --no-figures --out trace-nothing",
    "compare": "compare rigid longitudinal --json",
    "campaign": "campaign rigid --runs 2 --seed 1 --out campaign --no-figures",
    "identify": f"identify {FIRST} --no-figures --out identified",
    "equation-error": f"identify {FIRST} --method equation-error --no-figures --out regressed",
    "filter-error": f"identify {FIRST} --method filter-error --no-figures --out filtered",
    "predict": "predict identified flight_validate.csv --json",
    "response": "response flight.csv --input elevator --output q --json",
    "maneuvers": "maneuvers flight.csv --json",
    "map": "map flight.csv",
    "check": "check flight.csv --vehicle flight_vehicle.toml --no-figures --out checked",
    "aircraft": "simulate aircraft-airliner --seed 3 --out airliner.csv",
    "check-aircraft": "check airliner.csv --no-figures --out checked-airliner",
    "watch": f"watch {FIRST} --out watched",
    "diagnose": f"diagnose {FIRST} --validate flight_validate.csv --no-figures --out diagnosed",
    "export": "export identified --to python --out exported.py",
    "models": "models",
    "vehicles": "vehicles",
    "effects": "effects",
    "list": "list",
}
_SCRATCH = re.compile(r"flightid-[a-z0-9_]{8}(?=/)")  # folders made for one run
# Times, versions and paths of a machine.
PASSED_OVER = ("seconds", "version", "created", "runtime", "elapsed", "python", "machine", "folder")


def run(checkout: Path, folder: Path, names: list[str]) -> None:
    """Run the commands by one checkout; each leaves NAME.stdout with its exit code."""
    settings = {**os.environ, "PYTHONPATH": str(checkout), "COLUMNS": "120", "NO_COLOR": "1"}
    for name in names:
        done = subprocess.run(
            [sys.executable, "-m", "scenarios", *COMMANDS[name].split()],
            cwd=folder,
            env=settings,
            capture_output=True,
            text=True,
        )
        (folder / f"{name}.stdout").write_text(f"{done.returncode}\n{done.stdout}")
        print(f"  {name}: exit code {done.returncode} {done.stderr[-200:]}", flush=True)


def differences(old: Any, new: Any, where: str) -> Iterator[str]:
    """One line for each entry of two documents that differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}, key=str):
            if not any(word in str(key).lower() for word in PASSED_OVER):
                yield from differences(old.get(key), new.get(key), f"{where}/{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for at, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from differences(one, other, f"{where}/{at}")
    elif isinstance(old, float) and isinstance(new, float | int):
        same = math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
        if not same and not (math.isnan(old) and math.isnan(new)):
            yield f"{where}: {old!r}, now {new!r}"
    elif old != new:
        yield f"{where}: {str(old)[:120]!r}, now {str(new)[:120]!r}"


def content(path: Path) -> Any:
    """A file as numbers and words: a JSON document, or lines split into fields."""
    text = _SCRATCH.sub("flightid-", path.read_text(encoding="utf-8", errors="replace"))
    try:
        return json.loads(text)
    except ValueError:
        rows = csv.reader(text.splitlines()) if path.suffix == ".csv" else [[text]]
        return [[_number(field) for field in row] for row in rows]


def _number(field: str) -> float | str:
    try:
        return float(field)
    except ValueError:
        return field


def main() -> int:
    """Run both checkouts and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("--only", default=",".join(COMMANDS))
    parser.add_argument("--keep", type=Path, help="folder for the results; those there are reused")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        base = (asked.keep or Path(scratch)).absolute()
        folders = {"old": asked.old.absolute(), "new": ROOT}
        for name, checkout in folders.items():
            if name == "new" or not (base / name).exists():
                (base / name).mkdir(parents=True, exist_ok=True)
                print(f"{name}: {checkout}")
                run(checkout, base / name, asked.only.split(","))
        files = {
            path.relative_to(base / name)
            for name in folders
            for path in (base / name).rglob("*")
            if path.suffix in (".json", ".csv", ".stdout", ".toml")
        }
        found: list[str] = []
        for file in sorted(files):
            pair = [base / name / file for name in folders]
            if all(path.is_file() for path in pair):
                found += differences(content(pair[0]), content(pair[1]), str(file))
            else:
                found.append(f"{file}: only one checkout wrote it")
        print(*found[:50], f"{len(files)} files, {len(found)} differences", sep="\n")
        return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main())
