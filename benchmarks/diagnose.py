"""How long a diagnosis takes as a whole process, by what is missing in the model.

    python benchmarks/diagnose.py [--runs N]

Records of 1001 samples and three channels with nothing, one effect, two, and something outside the
library, and of 8001 with one; figures and report included. The ratio is to the record with nothing
missing, so that runs on different machines compare. As where the package is installed its compiled
files are kept (in a folder of the run's own), and the first run, which compiles them, is not
counted.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
KINDS = {
    "trace-nothing": ("nothing", 1.0),
    "trace-delay": ("one effect", 2.0),
    "trace-pair": ("two effects", 4.0),
    "trace-outside": ("outside", 8.0),
}  # with the wall seconds asked for on two cores
LONG, LONG_LIMIT = ("trace-delay", ('flight.rate="400 Hz"',)), 12.0  # 8001 samples


def fly(name: str, folder: Path, changes: tuple[str, ...] = ()) -> tuple[list[Path], Path, Path]:
    """Training records, held-out record and vehicle file of a tracing scenario, with ``changes`` as
    of --set.
    """
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated

    folder.mkdir()
    scenario = trace_scenario_of(*load_document(name, changes))
    train, validate, vehicle = write_simulated(fly_trace(scenario, scenario.seed), folder)
    return [train], validate, vehicle


def as_installed(bytecode: Path) -> dict[str, str]:
    """The environment of a user who has set nothing."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name != "PYTHONDONTWRITEBYTECODE" and not name.endswith("_NUM_THREADS")
    }
    return kept | {"PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": str(bytecode)}


def diagnosed(
    files: tuple[list[Path], Path, Path], folder: Path, runs: int, model: str = "rigid"
) -> tuple[float, float]:
    """Median wall and processor seconds."""
    train, validate, vehicle = files
    command = [sys.executable, "-m", "scenarios", "diagnose", *map(str, train), "--model", model]
    command += ["--vehicle", str(vehicle), "--validate", str(validate), "--out", "out"]
    environment = as_installed(folder.parent / "bytecode")
    walls, processors = [], []
    for number in range(runs + 1):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
        wall = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if number:
            walls.append(wall)
            processors.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(walls), statistics.median(processors)


def line(words: str, limit: float, wall: float, processor: float, reference: float) -> str:
    """Wall and processor seconds, and the ratio to a reference's wall seconds."""
    return (
        f"{words:12} wall {wall:5.1f} s (asked {limit:g}), processor {processor:5.1f} s, "
        f"{wall / reference:4.1f} x nothing"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    reference = 0.0
    with tempfile.TemporaryDirectory() as temporary:
        for name, (words, limit) in KINDS.items():
            folder = Path(temporary) / name
            wall, processor = diagnosed(fly(name, folder), folder, arguments.runs)
            reference = reference or wall
            print(line(words, limit, wall, processor, reference), flush=True)
        name, changes = LONG
        wall, processor = diagnosed(
            fly(name, Path(temporary) / "long", changes), Path(temporary) / "long", arguments.runs
        )
        print(line("8001 samples", LONG_LIMIT, wall, processor, reference))


if __name__ == "__main__":
    main()
