"""A watch in progress: rows go in, the banks move on.

The first rows are only collected: the noise levels, the trim and the start of two states are read
off them, then they are filtered like all others. What the filter is given, spikes left out, is the
record that a batch run would get.

The figure with which the page of a stream begins: parameters while the stream arrived.
"""

from __future__ import annotations

import csv
import io
import math
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ident.banks.online import (
    BankState,
    FinalStates,
    OnlineBank,
    Rows,
    advance,
    bank_of_starts,
    begin,
    final_states_of,
    moved_starts,
    online_bank,
    spread_of,
)
from ident.banks.relinearised import (
    Relinearised,
    advanced,
    bank_that_continues,
    informative_enough,
    linearisation_due,
    linearise,
    with_fitting_grid,
)
from scenarios.files.declarations import ColumnChoice
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.low_order import filter_system, less, noise_levels, trim_of
from scenarios.preparation.plan import BY_HAND
from scenarios.report.document import Section, section
from scenarios.report.figure_formats import USUAL
from scenarios.report.folder import figures
from scenarios.watching.line_cells import is_row
from scenarios.watching.loop_margins import STARTING_TIME
from scenarios.watching.reference import Reference, vehicle_to_watch
from scenarios.watching.rows import (
    LOES,
    OUTPUTS,
    Fault,
    Header,
    Lines,
    Order,
    StreamSignals,
    in_order,
    read_header,
    read_lines,
)
from scenarios.watching.spectral import SpectralSession, spectral_session
from scenarios.watching.spectral import take as take_in_frequency
from sim.declaration.model import System
from sim.errors import RecordError
from sim.record import Channel, Hold, Record

# ---- A watch in progress

FEWEST_STARTING_ROWS = 40
SPIKE_SIGMAS = 30.0  # standard deviations of the innovation
# parameters that a vehicle file gives
STARTED = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau")
RELINEARISED_ROWS = 1600  # 40 s at 40 Hz: two seconds of computing
# of the rows at the last attempt: all of them together then cost five times the last one
ATTEMPT_GROWTH = 1.25
# rows over which the stick should not have moved before a part of a record begins: the longest
# delay and the lag
STEADY_STICK_ROWS = 20
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g"}


class WatchStep(NamedTuple):
    """A row of the stream, the bank's state after it, how many spikes were left out by then, what
    other starts add to its deviations ``spread (n,)`` and to the delay's (s), their differences
    ``(K, n)``, and the bank that was linearised anew, if there is one."""

    row: np.ndarray
    state: BankState
    spikes: int
    spread: np.ndarray
    delay_spread: float
    differences: np.ndarray
    refined: Relinearised | None


@dataclass
class Session:
    """State of an on-line estimate with a bank of filters; ``take`` and ``start`` change it.

    Attributes
    ----------
    taken : blocks of rows ``(5, n)``: time, stick, alpha, q, nz; spikes are NaN.
    system, bank, state, offsets : of the filters, once they have started.
    others : bank with other starts, and its state.
    last : the last step.
    refine : whether the bank is relinearised from time to time.
    tried, first : number of rows at the last relinearisation, and its first row.
    spectral : regression in the frequency domain of the same rows, without spikes.
    """

    vehicle: VehicleFile
    name: str
    stick_unit: str
    taken: list[np.ndarray] = field(default_factory=list)
    system: System | None = None
    bank: OnlineBank | None = None
    state: BankState | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)
    spikes: int = 0
    refine: bool = False
    others: OnlineBank | None = None
    others_state: BankState | None = None
    refined: Relinearised | None = None
    tried: int = 0
    first: int = 0
    spectral: SpectralSession | None = None
    second: float = -math.inf
    last: WatchStep | None = None

    @property
    def rows(self) -> int:
        """Number of rows so far."""
        return sum(block.shape[1] for block in self.taken)


def take(session: Session, rows: np.ndarray) -> list[WatchStep]:
    """Filter rows ``(5, N)`` and return the steps; none before the filter starts."""
    if rows.shape[1] == 0:
        return []
    session.taken.append(np.array(rows))
    if session.bank is None:
        times = [
            float(block[0, column])
            for block, column in ((session.taken[0], 0), (session.taken[-1], -1))
        ]
        return (
            start(session)
            if times[1] - times[0] >= STARTING_TIME and session.rows >= FEWEST_STARTING_ROWS
            else []
        )
    return _filter(session, session.taken[-1])


def start(session: Session) -> list[WatchStep]:
    """Start the filter with the rows so far.

    Raises
    ------
    RecordError : fewer than two rows, or no number in any output.
    """
    if session.bank is not None:
        return []
    record = record_of(session)
    noise = noise_levels(record)
    session.offsets = trim_of(record, noise)
    session.system = filter_system(less(record, session.offsets), session.vehicle, noise)
    session.bank = online_bank(
        session.system, float(np.median(np.diff(record.time))), gate=SPIKE_SIGMAS
    )
    session.others = bank_of_starts(session.bank, moved_starts(session.bank, STARTED))
    session.taken = [np.concatenate(session.taken, axis=1)]
    return _filter(session, session.taken[0])


def record_of(session: Session) -> Record:
    """Return the rows so far as a record, with rejected spikes as missing samples.

    Raises
    ------
    RecordError : fewer than two rows, or no number in any output.
    """
    table = (
        np.concatenate(session.taken, axis=1) if session.taken else np.zeros((2 + len(OUTPUTS), 0))
    )
    if table.shape[1] < 2:
        raise RecordError(
            f"{table.shape[1]} row(s) that can be used",
            where=session.name,
            remedy="a stream needs at least two",
        )
    outputs = tuple(
        Channel.of(name, UNITS[name], row)
        for name, row in zip(OUTPUTS, table[2:], strict=True)
        if np.isfinite(row).any()
    )
    if not outputs:
        raise RecordError(
            "no number in any output",
            where=session.name,
            remedy=f"stream one of {', '.join(OUTPUTS)}",
        )
    return Record(
        table[0], (Channel.of("stick", session.stick_unit, table[1]),), outputs, name=session.name
    )


def _filter(session: Session, block: np.ndarray) -> list[WatchStep]:
    """Move the banks over the block's rows; spikes that the first leaves out become NaN in the
    block, and the others do not see them.
    """
    bank, others = session.bank, session.others
    assert bank is not None and others is not None
    states = _on(bank, session.state, _rows_of(session, block))
    session.state = states[-1]
    spikes = []
    for column, state in enumerate(states):
        if state.skipped.any():
            block[2:, column][state.skipped] = np.nan
            session.spikes += int(state.skipped.sum())
        spikes.append(session.spikes)
    if session.spectral is not None:
        take_in_frequency(session.spectral, block)
    given = _rows_of(session, block)
    beside = _on(others, session.others_state, given)
    session.others_state = beside[-1]
    ends = final_states_of(others, beside, len(bank.delays))
    spread = spread_of(bank, states, ends)
    refined = _refined(session, states, ends, given) if session.refine else [None] * len(states)
    columns = zip(
        block.T,
        states,
        spikes,
        spread.std,
        spread.delay.tolist(),
        spread.differences,
        refined,
        strict=True,
    )
    steps = [WatchStep(*each) for each in columns]
    session.last = steps[-1]
    return steps


def _refined(
    session: Session, states: list[BankState], ends: FinalStates, given: Rows
) -> list[Relinearised | None]:
    """Filter rows and relinearise the bank when due, checked at the first row of each second."""
    seconds = np.floor(given.time)
    new_seconds = np.flatnonzero(np.diff(seconds, prepend=session.second) > 0).tolist()
    session.second = float(seconds[-1])
    out: list[Relinearised | None] = []
    for row in [*new_seconds, len(states) - 1]:
        if row < len(out):
            continue
        stretch = slice(len(out), row + 1)
        passed = (
            [None] * (row + 1 - len(out))
            if session.refined is None
            else advanced(session.refined, Rows(*(part[..., stretch] for part in given)))
        )
        session.refined = passed[-1]
        if row in new_seconds:
            if session.refined is not None:
                session.refined = with_fitting_grid(session.refined)
            if _wanted(session, states[row]):
                session.tried, before = states[row].rows_seen, session.first
                result = _linearised(session, states[row], ends.mean[row].T)
                same = session.refined is None or session.first == before
                session.refined = (
                    result
                    if same and result is not None
                    else bank_that_continues(session.refined, result, STARTED)
                )
        out += [*passed[:-1], session.refined]
    return out


def _wanted(session: Session, state: BankState) -> bool:
    assert session.bank is not None
    if state.rows_seen - session.first < ATTEMPT_GROWTH * (session.tried - session.first):
        return False
    if session.refined is None:
        return informative_enough(session.bank, state, STARTED)
    return linearisation_due(session.refined, STARTED)


def _linearised(
    session: Session, state: BankState, other_starts: np.ndarray
) -> Relinearised | None:
    """Linearise over the rows up to a state, of many the last, from where the aircraft was
    steady.
    """
    assert session.bank is not None
    record, last = record_of(session), state.rows_seen
    if last - session.first > RELINEARISED_ROWS:
        earliest = last - RELINEARISED_ROWS
        session.first = (
            onset(record, earliest)
            if session.refined is None
            else steadiest(record, earliest, last - RELINEARISED_ROWS // 2)
        )
    first = session.first
    record = less(record.window(float(record.time[first]), state.time), session.offsets)
    system = filter_system(record, session.vehicle, noise_levels(record))
    if first:
        levels: dict[str, float] = {
            name: float(record[name].values[0])
            for name in ("alpha", "q")
            if name in record.output_names and record[name].valid[0]
        }
        system = replace(system, initial=system.initial.with_values(levels))
    return linearise(record, system, session.bank, state, other_starts)


def onset(record: Record, first: int) -> int:
    """Row one second before the stick first moves, from ``first`` on, by a twentieth of its largest
    motion.
    """
    stick = record["stick"].values[first:]
    away = np.abs(stick - np.median(stick))
    return max(first, first + int(np.argmax(away > 0.05 * away.max())) - FEWEST_STARTING_ROWS)


def steadiest(record: Record, first: int, last: int) -> int:
    """Return the row from ``first`` to before ``last`` at which the stick has moved and the
    aircraft pitches least, in shares of their largest.
    """
    stick, pitching = record["stick"].values, np.zeros(len(record))
    if "q" in record.output_names:
        pitching = np.abs(np.where(record["q"].valid, record["q"].values, np.inf))
    moved = np.ptp(np.lib.stride_tricks.sliding_window_view(stick, STEADY_STICK_ROWS), axis=1)
    rows = np.arange(max(first, STEADY_STICK_ROWS - 1), last)
    largest = [
        max(float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0)), 1e-12)
        for values in (stick, pitching)
    ]
    return int(
        rows[
            np.argmin(
                moved[rows - STEADY_STICK_ROWS + 1] / largest[0] + pitching[rows] / largest[1]
            )
        ]
    )


def _on(bank: OnlineBank, state: BankState | None, rows: Rows) -> list[BankState]:
    """Return the states after each row; without a state, from the first row of the stream."""
    if state is not None:
        return advance(bank, state, rows)
    first = begin(bank, Rows(*(part[..., :1] for part in rows)))
    return [first, *advance(bank, first, Rows(*(part[..., 1:] for part in rows)))]


def _rows_of(session: Session, block: np.ndarray) -> Rows:
    """Return a block about its trim."""
    levels = np.array([0.0, *(session.offsets.get(name, 0.0) for name in ("stick", *OUTPUTS))])[
        :, None
    ]
    given = block - levels
    return Rows(given[0], given[1:2], given[2:])


# ---- A watched stream: header, session, and dropped rows

STOPPED = "stopped by the user"
# rows that are filtered before they are written and shown: a few hundredths of a second
ROWS_PER_BATCH = 200


@dataclass
class Watch:
    """State of a watched stream.

    Attributes
    ----------
    beside : name of the record's JSON file, empty without one.
    columns : names of the columns, if the header is missing or not used.
    rate : Hz, for a stream without a clock.
    signals : that are read; ``session`` exists only for those of the low-order equivalent.
    omega : rad/s, of the regression in the frequency domain.
    hold : inputs between rows in this regression; None: decided by the rows.
    hold_from : words on who chose it.
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
    hold: Hold | None = None
    hold_from: str = BY_HAND
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
    """Return the rows of CSV lines."""
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
            watch.header = read_header(
                first,
                watch.name,
                watch.choices,
                watch.units,
                watch.columns,
                watch.rate,
                watch.line + 1,
                watch.signals,
            )
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
        outputs = [
            name
            for name, column in zip(LOES.outputs, header.columns[2:], strict=True)
            if column is not None
        ]
        if {"alpha", "q"} <= set(outputs):
            session.spectral = spectral_session(vehicle, watch.name, outputs, watch.omega)
    return session


def pieces(session: Session | None, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Yield rows in pieces of whole seconds, so that results do not depend on the input's chunks.

    One second at a time until the filter has started, then up to ``ROWS_PER_BATCH`` rows.
    """
    if session is None or not rows.size:
        return
    cuts = [*(np.flatnonzero(np.diff(np.floor(rows[0]))) + 1).tolist(), rows.shape[1]]
    first = 0
    while first < rows.shape[1]:
        ahead = [cut for cut in cuts if cut > first]
        fitting = (
            [cut for cut in ahead if cut <= first + ROWS_PER_BATCH]
            if session.bank is not None
            else []
        )
        last = max(fitting, default=ahead[0])
        yield rows[:, first:last]
        first = last


def session_of(watch: Watch) -> Session:
    """Return the session, which begins with the header. Raises RecordError if none came."""
    if watch.session is None:
        raise RecordError(
            "the stream is empty", where=watch.name, remedy="give a header row and one row a sample"
        )
    return watch.session


def report(watch: Watch, faults: list[Fault]) -> None:
    """Count faults, and print the first of each kind in one line."""
    for fault in faults:
        if fault.left_out:
            if not watch.left_out:
                print(
                    f"flightid: {watch.name}, row {fault.row}: {fault.what}; left out, others like "
                    "it are counted",
                    file=sys.stderr,
                )
            watch.left_out += 1
        else:
            if not watch.mended:
                print(
                    f"flightid: {watch.name}, row {fault.row}: {fault.what}; others like it are "
                    "counted",
                    file=sys.stderr,
                )
            watch.mended += 1


STEM = "watched"


def history_section(
    folder: Path, history: str, content: Mapping[str, Any], title: str
) -> tuple[Section, ...]:
    """Draw ``watched`` into ``folder``; the section of a page that shows it.

    ``history``: text of ``history.csv``, with columns ``NAME`` and ``NAME_std``. ``content``: of
    ``comparison.json``, which names the parameters and the reference. Nothing where fewer than two
    lines have an estimate.
    """
    time, courses = courses_of(history, content["parameters"])
    if len(time) < 2 or not courses:
        return ()
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.estimates import figure_watched

    reference = {
        each["name"]: (each["reference"], each["reference_std"])
        for each in (content.get("reference") or {}).get("differences", ())
        if each.get("reference") is not None and each.get("reference_std") is not None
    }
    make = partial(figure_watched, time, courses, reference, title)
    figure_files = draw_for_page([(STEM, make)], folder, USUAL)
    return section("While the stream arrived", *figures(figure_files))


def courses_of(
    history: str, parameters: Mapping[str, Mapping[str, Any]]
) -> tuple[np.ndarray, dict[str, tuple[str, np.ndarray, np.ndarray]]]:
    """Return the times ``(N,)`` and by parameter its unit, values and standard deviations ``(N,)``,
    NaN if a cell is empty; refined estimates where the history has them.
    """
    rows = list(csv.reader(io.StringIO(history)))
    if len(rows) < 2:
        return np.zeros(0), {}
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])
    column = {name: table[:, i] for i, name in enumerate(rows[0])}
    courses = {}
    for name, each in parameters.items():
        best = f"refined_{name}" if f"refined_{name}" in column else name
        if best in column and f"{best}_std" in column and np.any(np.isfinite(column[best])):
            courses[name] = str(each["unit"]), column[best], column[f"{best}_std"]
    return column["time"], courses
