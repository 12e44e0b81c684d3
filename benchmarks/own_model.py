"""The rigid short period written as a user's own file against the built-in one: identify and
diagnose, as whole processes by turns.

    python benchmarks/own_model.py [--runs N]

Records of the scenario trace-delay, 1001 samples and three channels. Printed are the ratios of the
medians, own over built in, which may be 1.3, and by how much any number of the two results differs,
relative to its size.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
LIMIT = 1.3
RESULTS = {"identify": "comparison.json", "diagnose": "diagnosis.json"}


def files(folder: Path) -> None:
    """Records, vehicle file and model file."""
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated
    from tests.own_models import SHORT_PERIOD

    scenario = trace_scenario_of(*load_document("trace-delay"))
    write_simulated(fly_trace(scenario, scenario.seed), folder)
    (folder / "short_period.py").write_text(SHORT_PERIOD)


def seconds(folder: Path, command: str, model: str, out: str) -> float:
    """Wall seconds of a command."""
    validate = ["--validate", "validate.csv"] if command == "diagnose" else []
    call = [
        sys.executable,
        "-m",
        "scenarios",
        command,
        "train.csv",
        *validate,
        "--model",
        model,
        "--vehicle",
        "vehicle.toml",
        "--out",
        out,
    ]
    start = time.perf_counter()
    subprocess.run(
        [*call, "--no-figures"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    return time.perf_counter() - start


def apart(one: Any, other: Any) -> Iterator[float]:
    """Relative differences of all numbers that stand at the same place of two results."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in one.keys() & other.keys():
            yield from apart(one[key], other[key])
    elif isinstance(one, list) and isinstance(other, list):
        for first, second in zip(one, other, strict=True):
            yield from apart(first, second)
    elif isinstance(one, float) and isinstance(other, float):
        yield abs(one - other) / max(abs(one), abs(other), 1e-300)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder)
        for command, result in RESULTS.items():
            models = {"built-in": "rigid", "own": "short_period.py"}
            walls: dict[str, list[float]] = {which: [] for which in models}
            for number in range(runs + 1):  # the first compiles
                for which, model in models.items():
                    wall = seconds(folder, command, model, f"{command}-{which}")
                    walls[which] += [wall] * (number > 0)
            own, built_in = (statistics.median(walls[which]) for which in ("own", "built-in"))
            found = [
                json.loads((folder / f"{command}-{which}" / result).read_text()) for which in models
            ]
            print(
                f"{command}: own {own:.2f} s, built in {built_in:.2f} s, ratio "
                f"{own / built_in:.2f} (at most {LIMIT})",
                end="",
            )
            print(f"; numbers at most {max(apart(*found)):.1g} apart")


if __name__ == "__main__":
    main()
