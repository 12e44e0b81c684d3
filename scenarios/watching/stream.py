"""A stream on its way through the filter: its header, its session, and what was left out."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scenarios.files.channels import ColumnChoice
from scenarios.watching.lines import Lines
from scenarios.watching.reference import Reference, vehicle_to_watch
from scenarios.watching.rows import (
    LOES,
    Fault,
    Header,
    Order,
    StreamSignals,
    in_order,
    is_row,
    read_header,
    read_lines,
)
from scenarios.watching.session import Session
from scenarios.watching.spectral import spectral_session
from sim.errors import RecordError

STOPPED = "stopped by the user"
TOGETHER = 200  # rows that are filtered before they are written and shown: a few hundredths of a second


@dataclass
class Watch:
    """What the loop changes: the header once it came, how far the stream is, and what was left out.

    ``beside``: name of the JSON file that was read because it is beside the record, empty without
    one. ``columns``: names of the columns,
    where there is no header or another one is wanted; ``rate``: Hz, where there is no clock.
    ``signals``: what the stream is read for; of others than the low-order equivalent's there is no
    ``session``. ``omega``: rad/s, of the regression in the frequency domain.
    """

    name: str
    vehicle_path: Path | None
    reference: Reference | None
    choices: Mapping[str, ColumnChoice] | None
    units: Mapping[str, str]
    refine: bool = True
    beside: str = ""
    columns: tuple[str, ...] = ()
    rate: float | None = None
    signals: StreamSignals = LOES
    omega: np.ndarray | None = None
    header: Header | None = None
    session: Session | None = None
    order: Order = field(default_factory=Order)
    line: int = 0
    left_out: int = 0
    mended: int = 0
    reason: str = "the stream ended"
    heard: float = field(default_factory=time.monotonic)

    @property
    def stopped(self) -> bool:
        """Whether the user stopped it."""
        return self.reason == STOPPED


def rows_in(watch: Watch, came: Lines) -> np.ndarray:
    """The rows that lines hold."""
    lines = came.whole
    if lines:
        watch.heard = time.monotonic()
    while watch.header is None and lines:
        first = lines[0]
        bare = bool(first.strip() and watch.columns) and is_row(first, watch.name)
        if not bare:
            watch.line += 1
            lines = lines[1:]
        if first.strip():
            watch.header = read_header(first, watch.name, watch.choices, watch.units, watch.columns, watch.rate, watch.line + 1, watch.signals)
            watch.order = watch.order._replace(inputs=watch.signals.inputs)
            if watch.signals is LOES:
                watch.session = _session(watch, watch.header)
    if watch.header is None or not lines:
        return np.zeros((0, 0))
    table, numbers, faults = read_lines(watch.header, lines, watch.line + 1)
    watch.line += len(lines)
    rows, disorder, watch.order = in_order(table, numbers, watch.order)
    report(watch, sorted([*faults, *disorder]))
    return rows


def _session(watch: Watch, header: Header) -> Session:
    """The banks of the low-order equivalent system, with a regression in the frequency domain."""
    vehicle = vehicle_to_watch(watch.vehicle_path, watch.reference)
    session = Session(vehicle, watch.name, header.stick_unit, refine=watch.refine)
    if watch.omega is not None:
        outputs = [name for name, column in zip(LOES.outputs, header.columns[2:], strict=True) if column is not None]
        if {"alpha", "q"} <= set(outputs):
            session.spectral = spectral_session(vehicle, watch.name, outputs, watch.omega)
    return session


def pieces(session: Session | None, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Rows cut where a second of the stream begins, so that what is shown does not hang on how they came: one second at a time until
    the filter has started, later as many as ``TOGETHER`` holds."""
    if session is None or not rows.size:
        return
    cuts = [*(np.flatnonzero(np.diff(np.floor(rows[0]))) + 1).tolist(), rows.shape[1]]
    first = 0
    while first < rows.shape[1]:
        ahead = [cut for cut in cuts if cut > first]
        fitting = [cut for cut in ahead if cut <= first + TOGETHER] if session.bank is not None else []
        last = max(fitting, default=ahead[0])
        yield rows[:, first:last]
        first = last


def session_of(watch: Watch) -> Session:
    """The session, which begins with the header. Raises RecordError where none came."""
    if watch.session is None:
        raise RecordError("the stream is empty", where=watch.name, remedy="give a header row and one row a sample")
    return watch.session


def report(watch: Watch, faults: list[Fault]) -> None:
    """Count faults, and say the first of each sort in one line."""
    for fault in faults:
        if fault.left_out:
            if not watch.left_out:
                print(f"flightid: {watch.name}, row {fault.row}: {fault.what}; left out, others like it are counted", file=sys.stderr)
            watch.left_out += 1
        else:
            if not watch.mended:
                print(f"flightid: {watch.name}, row {fault.row}: {fault.what}; others like it are counted", file=sys.stderr)
            watch.mended += 1
