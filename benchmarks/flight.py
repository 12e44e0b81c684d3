"""How long the diagnosis of a whole flight takes as a whole process, and the share of each step.

    python benchmarks/flight.py [--runs N]

Four records of 25 s at 40 Hz that look measured, three fitted and one held out, one effect hidden;
twelve channels a record, four of which no model knows. Figures and report included. The ratio is to
a record of 1001 samples with nothing missing and another held out, diagnosed in the same run, so
that runs on different machines compare.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
SEED, LIMIT = 401, 15.0  # with the wall seconds asked for on two cores
CHANGES = ("flight.records=[4,4]", "flight.optional=1")
# beside elevator, alpha, q, nz, theta, airspeed, dynamic pressure and ax
UNUSED = ("aileron", "roll_rate", "engine_speed", "fuel")


def fly_flight(folder: Path) -> tuple[list[Path], Path, Path]:
    """Records to fit, record held out and vehicle file of a surrogate flight for a measured
    flight.
    """
    from exam.surrogates.flights.flight import fly_surrogate, write_flight
    from exam.surrogates.schema import load_surrogate

    folder.mkdir()
    paths, vehicle = write_flight(
        fly_surrogate(load_surrogate("surrogate-one", CHANGES), SEED), folder
    )
    for path in paths:
        add_channels(path)
    return paths[:-1], paths[-1], vehicle


def add_channels(path: Path) -> None:
    """Put channels into a record that nothing uses."""
    header, *rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    wider = [
        [*header, *UNUSED],
        *(
            [*row, *(repr(0.1 * k + 1e-3 * (number % 50)) for k in range(len(UNUSED)))]
            for number, row in enumerate(rows)
        ),
    ]
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(wider)


def main() -> None:
    from benchmarks.diagnose import KINDS, diagnosed, fly, line

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        name, (words, limit) = next(iter(KINDS.items()))
        reference, processor, steps = diagnosed(
            fly(name, Path(temporary) / name), Path(temporary) / name, arguments.runs
        )
        print(line(words, limit, reference, processor, reference, steps), flush=True)
        flight = Path(temporary) / "flight"
        wall, processor, steps = diagnosed(fly_flight(flight), flight, arguments.runs)
        print(line("four records", LIMIT, wall, processor, reference, steps))


if __name__ == "__main__":
    main()
