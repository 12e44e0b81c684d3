"""Figures drawn by a second process, which loads the plotting library while the search still runs.

Loading it takes as long as many a diagnosis. Numbers go to it as NumPy's own array format and JSON; it answers with PNG files.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.diagnosis_figures import Pictured, draw_diagnosis
from sim.record import Channel, Hold, Record

Process = subprocess.Popen[bytes]


@contextmanager
def figure_process(wanted: bool) -> Iterator[Process | None]:
    """A process that waits for ``drawing``; None where none is wanted or none can be started. It ends with the body."""
    process: Process | None = None
    if wanted and sys.executable:
        # The same packages as here, also where they are not installed but found from the current folder.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        command = [sys.executable, "-m", "scenarios.figure_process"]
        with contextlib.suppress(OSError):
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    try:
        yield process
    finally:
        if process is not None:
            if process.poll() is None:
                process.kill()
            process.wait()
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()


@contextmanager
def drawing(pictured: Pictured, folder: Path, process: Process | None) -> Iterator[None]:
    """While the body runs, the process draws all figures into ``folder``; on leaving they are there, drawn here if it failed."""
    sent = process is not None and process.poll() is None and _sent(process, packed(pictured, folder))
    yield
    if not sent or process is None or process.wait() != 0:
        draw_diagnosis(pictured, folder)


def _sent(process: Process, content: bytes) -> bool:
    assert process.stdin is not None
    try:
        process.stdin.write(content)
        process.stdin.close()
    except OSError:
        return False
    return True


def packed(pictured: Pictured, folder: Path) -> bytes:
    """Everything the figures need as one line of JSON, in which arrays are numbers, and the arrays behind it."""
    arrays: list[np.ndarray] = []

    def kept(array: np.ndarray) -> int:
        arrays.append(np.asarray(array))
        return len(arrays) - 1

    def channels(some: tuple[Channel, ...]) -> list[Any]:
        return [[c.name, c.unit, kept(c.values), kept(c.valid)] for c in some]

    def record(r: Record) -> dict[str, Any]:
        return {"time": kept(r.time), "inputs": channels(r.inputs), "outputs": channels(r.outputs), "hold": r.hold.value, "name": r.name}

    head = {
        "folder": str(folder),
        "fitted": [[record(f.record), f.channels, kept(f.before), kept(f.after), kept(f.used)] for f in pictured.fitted],
        "predictions": [[record(p.record), p.channels, kept(p.before), kept(p.after)] for p in pictured.predictions],
        "candidates": [[c.round, c.within, c.name, c.gain, c.p_value, c.fitted, c.plausible] for c in pictured.candidates],
        "before": _quantities(pictured.before),
        "after": _quantities(pictured.after),
        "noise": dict(pictured.noise),
        "claimed": pictured.claimed,
        "held_out": pictured.held_out,
    }
    stream = io.BytesIO()
    stream.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


def unpacked(content: bytes) -> tuple[Pictured, Path]:
    """What ``packed`` was given."""
    stream = io.BytesIO(content)
    head = json.loads(stream.readline())
    arrays: list[np.ndarray] = []
    while stream.tell() < len(content):
        arrays.append(np.load(stream, allow_pickle=False))

    def channels(some: list[Any]) -> tuple[Channel, ...]:
        return tuple(Channel(name, unit, arrays[values], arrays[valid]) for name, unit, values, valid in some)

    def record(r: dict[str, Any]) -> Record:
        return Record(arrays[r["time"]], channels(r["inputs"]), channels(r["outputs"]), Hold(r["hold"]), r["name"])

    pictured = Pictured(
        tuple(FittedRecord(record(r), tuple(names), arrays[b], arrays[a], arrays[u]) for r, names, b, a, u in head["fitted"]),
        tuple(Prediction(record(r), tuple(names), arrays[b], arrays[a]) for r, names, b, a in head["predictions"]),
        tuple(Candidate(n, tuple(within), name, gain, p, fit, fair, {}) for n, within, name, gain, p, fit, fair in head["candidates"]),
        {name: Quantity(*parts) for name, parts in head["before"].items()},
        {name: Quantity(*parts) for name, parts in head["after"].items()},
        head["noise"],
        tuple(head["claimed"]),
        head["held_out"],
    )
    return pictured, Path(head["folder"])


def main() -> None:
    """Load, warm up, wait for what to draw, draw it; end silently where nothing comes."""
    from scenarios.plots.diagnosis import figure_derivatives
    from scenarios.plots.files import figure_png

    one = {name: Quantity(1.0, 0.1, "1") for name in ("Cm_alpha", "CL_q", "alpha", "nz")}
    figure_png(figure_derivatives(one, one, "warm-up"))  # fonts, symbols and backend are loaded by the first figure
    content = sys.stdin.buffer.read()
    if content:
        draw_diagnosis(*unpacked(content))


def _quantities(some: Mapping[str, Quantity]) -> dict[str, list[Any]]:
    return {name: [q.value, q.std, q.unit] for name, q in some.items()}


if __name__ == "__main__":
    main()
