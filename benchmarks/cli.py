"""How long commands take as whole processes, from a cold start with their imports: wall and
processor seconds.

    python benchmarks/cli.py [--runs N] [--without-catalogue]

Each figure is the median of N processes. The ratio is to a process that imports what every study
needs and does nothing, so that runs on different machines compare. The processor figure is the
honest one where other programs share the machine.
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
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = (
    "import numpy, scipy.linalg, filterpy.kalman, matplotlib.figure, "
    "matplotlib.backends.backend_agg"
)
FLIGHTID = [sys.executable, "-m", "scenarios"]
NINE = (
    "ballistic",
    "ballistic-process-noise",
    "rigid",
    "rigid-process-noise-a",
    "rigid-process-noise-b",
    "flexible-ac1-equivalent",
    "flexible-ac2-equivalent",
    "flexible-ac1-first-mode",
    "flexible-ac2-first-mode",
)
IMPORT_LIMIT = 0.15  # s
HELP_LIMIT, RIGID_LIMIT, CATALOGUE_LIMIT = 0.3, 5.0, 60.0  # s, what is asked for on two cores


def measured(command: Sequence[str], folder: Path, runs: int) -> tuple[float, float]:
    """Median wall and processor seconds of a command run ``runs`` times in a folder."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    walls, processors = [], []
    for _ in range(runs):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        walls.append(time.perf_counter() - start)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        processors.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(walls), statistics.median(processors)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--runs",
        type=int,
        default=5,
        help="processes a figure is the median of; the catalogue is run once",
    )
    parser.add_argument("--without-catalogue", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        subprocess.run(
            [*FLIGHTID, "run", "rigid", "--out", "warm-up"],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            check=True,
            stdout=subprocess.DEVNULL,
        )
        cases: list[tuple[str, list[str], int, float | None]] = [
            ("imports alone", [sys.executable, "-c", REFERENCE], arguments.runs, None),
            (
                "import flightid",
                [sys.executable, "-c", "import flightid"],
                arguments.runs,
                IMPORT_LIMIT,
            ),
            ("--help", [*FLIGHTID, "--help"], arguments.runs, HELP_LIMIT),
            ("list", [*FLIGHTID, "list"], arguments.runs, None),
            ("run rigid", [*FLIGHTID, "run", "rigid"], arguments.runs, RIGID_LIMIT),
            (
                "run rigid --out",
                [*FLIGHTID, "run", "rigid", "--out", "study"],
                arguments.runs,
                RIGID_LIMIT,
            ),
            (
                "fid.run('rigid')",
                [sys.executable, "-c", "import flightid; flightid.run('rigid')"],
                arguments.runs,
                RIGID_LIMIT,
            ),
            (
                "simulate rigid",
                [*FLIGHTID, "simulate", "rigid", "--out", "record.csv"],
                arguments.runs,
                None,
            ),
        ]
        if not arguments.without_catalogue:
            cases.append(
                (
                    "run, nine --out",
                    [*FLIGHTID, "run", *NINE, "--out", "studies"],
                    1,
                    CATALOGUE_LIMIT,
                )
            )
        print(
            f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
        )
        print(f"{'process':24s}{'wall, s':>10s}{'processor, s':>14s}{'ratio':>8s}{'asked, s':>10s}")
        reference = 0.0
        for name, command, runs, limit in cases:
            wall, processor = measured(command, folder, runs)
            reference = reference or processor
            print(
                f"{name:24s}{wall:10.2f}{processor:14.2f}{processor / reference:8.2f}{'' if limit is None else f'{limit:10.2f}'}",  # noqa: E501
                flush=True,
            )


if __name__ == "__main__":
    main()
