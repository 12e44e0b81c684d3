"""Rows per second of the on-line bank and of `watch` as a whole, against the 40 Hz of telemetry and
against the batched bank in the same run.

    python benchmarks/watch.py [--seconds N] [--rounds N]

The stream is the flight-like airframe's record, again and again with the time going on. `bank, rows
that wait` takes as many rows at a time as `watch` does when it is behind; `bank, row by row` calls
it for each row. `lines to history` is all that happens while a stream is followed: parsing, order,
bank, history on disk, a line a second. Starting and the refinement at the end are not in it. Times
are those of the processor, which wait for nothing else on the machine; the best and the median of
the rounds. Set OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.banks.bank import run_bank
from ident.banks.delays import DELAYS
from ident.banks.online import (
    BankState,
    OnlineBank,
    Rows,
    advance,
    bank_estimate,
    begin,
    online_bank,
)
from scenarios.cli.watch import _watch_of, _write_steps
from scenarios.files.writing import write_record
from scenarios.identification.low_order import PAPER_START, loes_filter_system
from scenarios.preparation.plan import plan_of
from scenarios.watching.rows import growing_file, lines_of
from scenarios.watching.session import ROWS_PER_BATCH, pieces, rows_in, session_of, take
from scenarios.watching.show import Show
from scenarios.watching.study import History
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.nonlinear import fly_closed_loop, three_two_one_one
from sim.declaration.model import System
from sim.record import Channel, Record
from sim.vehicles.factory import model_from_constants

RATE = 40.0  # Hz
ROW_BY_ROW = 400  # rows of the slowest way


def problem(seconds: float) -> tuple[Record, System]:
    """Twenty seconds of flight repeated for so long, and the filter for it."""
    x29 = load_x29("F")
    once = fly_closed_loop(x29, three_two_one_one(1.0, 0.5, 1.0), 20.0, np.random.default_rng(1))[0]
    count = max(2, round(seconds * RATE))
    at = np.arange(count) % len(once)

    def repeated(channel: Channel) -> Channel:
        return replace(channel, values=channel.values[at], valid=channel.valid[at])

    record = Record(
        np.arange(count) / RATE,
        tuple(map(repeated, once.inputs)),
        tuple(map(repeated, once.outputs)),
    )
    constants = {
        "airspeed": x29.airframe.airspeed,
        "gravity": x29.airframe.gravity,
        "vane_arm": x29.telemetry.vane_arm,
    }
    noise = {
        "alpha": x29.telemetry.alpha_noise,
        "q": x29.telemetry.q_noise,
        "nz": x29.telemetry.nz_noise,
    }
    return record, loes_filter_system(
        model_from_constants("loes", constants, PAPER_START), record, noise, {"q": 1e-6}
    )


def online(bank: OnlineBank, rows: Rows, together: int) -> BankState:
    """The last state of rows that come so many at a time."""
    state = begin(bank, Rows(*(part[..., :1] for part in rows)))
    for first in range(1, rows.time.size, together):
        state = advance(bank, state, Rows(*(part[..., first : first + together] for part in rows)))[
            -1
        ]
    return state


def follow(record: Record) -> float:
    """Seconds that `watch` takes for a file that is there already, from the filter's start on."""
    with (
        tempfile.TemporaryDirectory() as folder,
        open(os.devnull, "w") as nowhere,
        contextlib.redirect_stdout(nowhere),
    ):
        path, _ = write_record(folder, record)
        watch, begun = _watch_of(str(path), None, None, None, False, plan_of(), ()), 0.0
        show = Show(watch)
        with growing_file(path, until_end=True) as read, History(Path(folder)) as history:
            for came in lines_of(read, None, "stream"):
                came_in = rows_in(watch, came)
                for piece in pieces(watch.session, came_in):
                    steps = take(session_of(watch), piece)
                    _write_steps(history, session_of(watch), steps)
                    show(steps)
                    begun = begun or (time.process_time() if steps else 0.0)
            return time.process_time() - begun


def timed(work: Callable[[], object]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Rows per second of the on-line bank and of watch."
    )
    parser.add_argument("--seconds", type=float, default=120.0, help="of telemetry")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    record, system = problem(given.seconds)
    z, valid = record.output_array(system.output_names)
    rows = Rows(record.time, record.input_array(system.input_names), np.where(valid, z, np.nan))
    some = Rows(*(part[..., :ROW_BY_ROW] for part in rows))
    bank, held = online_bank(system, 1.0 / RATE), {"delay": np.array(DELAYS)}
    follow(record.window(0.0, 10.0))
    times: dict[str, list[float]] = {
        "batched bank": [],
        "bank, rows that wait": [],
        "bank, row by row": [],
        "lines to history": [],
    }
    for _ in range(given.rounds):
        times["batched bank"].append(
            timed(lambda: run_bank(record, system, fixed_values=held)) / len(record)
        )
        times["bank, rows that wait"].append(
            timed(lambda: online(bank, rows, ROWS_PER_BATCH)) / len(record)
        )
        times["bank, row by row"].append(timed(lambda: online(bank, some, 1)) / ROW_BY_ROW)
        times["lines to history"].append(follow(record) / (len(record) - 2.0 * RATE))
    reference = statistics.median(times["batched bank"])
    print(f"nine filters of {len(bank.names)} states, {len(record)} rows, {given.rounds} rounds")
    for name, seconds in times.items():
        best, median = 1.0 / min(seconds), 1.0 / statistics.median(seconds)
        print(
            f"{name:22s} {median:7.0f} rows/s, best {best:7.0f}; {median / RATE:5.0f} times 40 Hz; "
            f"{reference * median:5.2f} x the batch"
        )
    found, expected = (
        bank_estimate(bank, online(bank, rows, ROWS_PER_BATCH)),
        run_bank(record, system, fixed_values=held),
    )
    print(
        f"busy at {RATE:g} Hz: {100.0 * RATE * statistics.median(times['lines to history']):.0f} % "
        "of one core"
    )
    print(
        "largest difference from the batch "
        f"{np.max(np.abs(found.mean - expected.mean) / expected.std):.1e} sigma"
    )


if __name__ == "__main__":
    main()
