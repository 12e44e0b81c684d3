"""Files that a command visits from its request to its page: those of which a function runs.

    python benchmarks/walk.py [diagnose|identify|run] [--list]

What runs while a module is loaded does not count. ``--list`` names the files by package.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import runpy
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
ROOMS = ("sim", "ident", "scenarios", "flightid")
RECORD = "flight.csv --model rigid --vehicle flight_vehicle.toml"
COMMANDS = {
    "diagnose": f"diagnose {RECORD} --validate flight_validate.csv --no-figures --out study",
    "identify": f"identify {RECORD} --no-figures --out study",
    "run": "run rigid --no-figures --out study",
}


def visited(arguments: list[str]) -> list[str]:
    """Files, below the root and in the order of the first call, that a command visits."""
    found: dict[str, None] = {}
    tops = tuple(f"{ROOT / room}{os.sep}" for room in ROOMS)

    def called(frame: FrameType, event: str, argument: Any) -> None:
        file = frame.f_code.co_filename
        if file in found or not file.startswith(tops) or frame.f_code.co_name == "<module>":
            return
        above = frame.f_back
        while above is not None:
            name, place = above.f_code.co_name, above.f_code.co_filename
            if name == "<module>" and place.startswith(tops) and not place.endswith("__main__.py"):
                return  # a module is being loaded
            above = above.f_back
        found[file] = None

    sys.argv = ["flightid", *arguments]
    sys.settrace(called)
    try:
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
            runpy.run_module("scenarios", run_name="__main__")
    finally:
        sys.settrace(None)
    return [Path(file).relative_to(ROOT).as_posix() for file in found]


def main() -> int:
    """Count, and list, the files of one command, or each command in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("command", nargs="?", choices=COMMANDS)
    parser.add_argument("--list", action="store_true")
    asked = parser.parse_args()
    if asked.command is None:
        for name in COMMANDS:
            further = ["--list"] if asked.list else []
            subprocess.run([sys.executable, __file__, name, *further], check=True)
        return 0
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        if asked.command != "run":
            flown = "simulate trace-delay --seed 7 --out flight.csv --quiet"
            made = {**os.environ, "PYTHONPATH": str(ROOT)}
            subprocess.run(
                [sys.executable, "-m", "scenarios", *flown.split()], check=True, env=made
            )
        files = visited(COMMANDS[asked.command].split())
        os.chdir(ROOT)
    effects = [file for file in files if file.startswith("sim/effects/") and file.count("/") == 3]
    print(f"{asked.command}: {len(files)} files, {len(effects)} of them candidate effects")
    if asked.list:
        by_package = defaultdict(list)
        for file in files:
            by_package[str(Path(file).parent)].append(Path(file).stem)
        for package, names in sorted(by_package.items()):
            print(f"  {package}: {', '.join(sorted(names))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
