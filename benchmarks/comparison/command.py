"""The command: which jobs, how thoroughly, written where."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.comparison.whole_process import ONE_THREAD, ROOT, ProcessFailed

STOPPED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done, 1 a contender failed, 2 bad usage, 130 stopped by Ctrl-C; what is written
    is written whole or not at all.
    """
    os.environ.update(ONE_THREAD)  # before anything imports NumPy
    try:
        return _main(arguments)
    except KeyboardInterrupt:
        print("stopped; nothing was written", file=sys.stderr)
        return STOPPED
    except ProcessFailed as failed:
        print(f"benchmarks: {failed}; nothing was written", file=sys.stderr)
        return 1


def _main(arguments: Sequence[str] | None) -> int:
    from benchmarks.comparison.compare import QUICK, Pace, compare
    from benchmarks.comparison.figure import drawn
    from benchmarks.comparison.machine import machine
    from benchmarks.comparison.page import document, page
    from benchmarks.jobs.catalogue import JOBS
    from benchmarks.scaling.catalogue import TABLES

    known = {job.name: job for job in JOBS}
    everything = [*known, *TABLES]
    about = "flightid beside its peers, cold and warm, in one run; writes docs/performance.md."
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=about)
    parser.add_argument("--jobs", help=f"only these, separated by commas: {', '.join(everything)}")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="few rounds and small problems: to see that all runs, not for numbers",
    )
    where = (
        "folder for performance.md, .json and .png; docs where all is measured in full, else "
        "nothing is written"
    )
    parser.add_argument("--out", type=Path, help=where)
    chosen = parser.parse_args(arguments)
    names = everything if chosen.jobs is None else chosen.jobs.split(",")
    wrong = [name for name in names if name not in everything]
    if wrong:
        parser.error(f"there is no job {wrong[0]!r}: use {', '.join(everything)}")
    whole = chosen.jobs is None and not chosen.quick
    out = chosen.out or (ROOT / "docs" if whole else None)
    if out is not None and not out.is_dir():
        parser.error(f"--out: there is no folder {out}")

    begin = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - begin:5.0f} s] {text}", file=sys.stderr, flush=True)

    described, pace = machine(), QUICK if chosen.quick else Pace()
    with tempfile.TemporaryDirectory(prefix="flightid-benchmarks-") as temporary:
        folder = Path(temporary)
        compared = [
            (known[name], compare(known[name], pace, folder, say))
            for name in names
            if name in known
        ]
        tables = [TABLES[name](pace, folder, say) for name in names if name in TABLES]
    text = page(described, compared, tables)
    if out is None:
        print(text)
        return 0
    files = {
        "performance.md": text.encode(),
        "performance.json": document(described, compared, tables).encode(),
    }
    if compared:
        files["performance.png"] = drawn(compared)
    _written_whole({out / name: content for name, content in files.items()})
    say(f"written: {', '.join(str(out / name) for name in files)}")
    return 0


def _written_whole(contents: dict[Path, bytes]) -> None:
    """All files or none: each is written beside its place first."""
    beside = {path: path.with_name(f".{path.name}.new") for path in contents}
    try:
        for path, content in contents.items():
            beside[path].write_bytes(content)
        for path, new in beside.items():
            new.replace(path)
    finally:
        for new in beside.values():
            new.unlink(missing_ok=True)
