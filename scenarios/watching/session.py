"""A watch in progress: banks of filters estimate a low-order system from the rows of a stream.

The first rows are only collected. They give the noise levels, the trim and the initial values of
two states; then they are filtered like all others. The rows without spikes are the record that an
identification of the whole record would use.

This module also draws the first figure of a watch's page: parameters over the time of the stream.
"""

from __future__ import annotations

import csv
import io
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ident.banks.online import (
    BankState,
    MostLikelyByStart,
    OnlineBank,
    Rows,
    advance,
    bank_of_starts,
    begin,
    changed_starts,
    most_likely_by_start,
    online_bank,
    start_spread,
)
from ident.banks.relinearised import (
    Relinearised,
    advance_bank,
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
from scenarios.report.figure_formats import USUAL, Formats
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

FEWEST_STARTING_ROWS = 40  # before the filters start; before the stick moves in a relinearisation
SPIKE_SIGMAS = 30.0  # an innovation of more standard deviations is a spike
# Parameters whose starts a vehicle file gives.
STARTED = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau")
# Most rows of a relinearisation: 40 s at 40 Hz, which take two seconds of computing.
RELINEARISED_ROWS = 1600
# Ratio of the numbers of rows of two successive relinearisations: all of them together cost five
# times as much as the last one.
ATTEMPT_GROWTH = 1.25
# Rows in which the stick should not move before a relinearisation begins: longest delay and lag.
STEADY_STICK_ROWS = 20
STICK_MOTION_SHARE = 0.05  # the stick moves if it is farther off, as a share of its largest motion
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g"}


class WatchStep(NamedTuple):
    """A row of the stream and the estimates after it.

    Attributes
    ----------
    row : time, stick, alpha, q, nz; shape ``(5,)``.
    state : state of the bank after the row.
    spikes : number of spikes that were left out so far.
    spread : standard deviations of the parameters due to their starts, from filters with other
        starts, shape ``(n,)``.
    delay_spread : the same for the delay, s.
    differences : differences of the K other filters from the most likely one, shape ``(K, n)``.
    refined : the relinearised bank, if there is one.
    """

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
    vehicle : the vehicle file.
    name : name of the stream.
    stick_unit : unit of the stick.
    taken : blocks of rows, shape ``(5, n)``: time, stick, alpha, q, nz; a spike is NaN.
    system, bank, state : model, filters and their state; None before the filters start.
    offsets : trim by channel; empty before the filters start.
    spikes : number of spikes so far.
    refine : whether the bank is relinearised from time to time.
    others, others_state : bank with other starts, and its state.
    refined : the relinearised bank, or None.
    tried : number of rows at the last relinearisation.
    first : first row of the last relinearisation.
    spectral : regression in the frequency domain on the same rows, or None.
    second : the last second of the stream for which a relinearisation was considered, s.
    last : the last step.
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
    """Filter rows, ``(5, N)``, and return the steps; none before the filters start."""
    if rows.shape[1] == 0:
        return []
    session.taken.append(np.array(rows))
    if session.bank is not None:
        return _filter(session, session.taken[-1])
    duration = float(session.taken[-1][0, -1]) - float(session.taken[0][0, 0])
    if duration >= STARTING_TIME and session.rows >= FEWEST_STARTING_ROWS:
        return start(session)
    return []


def start(session: Session) -> list[WatchStep]:
    """Start the filters with the rows so far, and return the steps of these rows.

    Raises
    ------
    RecordError : there are fewer than two rows, or no output has a number.
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
    session.others = bank_of_starts(session.bank, changed_starts(session.bank, STARTED))
    session.taken = [np.concatenate(session.taken, axis=1)]
    return _filter(session, session.taken[0])


def record_of(session: Session) -> Record:
    """Return the rows so far as a record in which spikes are missing samples.

    Raises
    ------
    RecordError : there are fewer than two rows, or no output has a number.
    """
    table = np.zeros((2 + len(OUTPUTS), 0))
    if session.taken:
        table = np.concatenate(session.taken, axis=1)
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
    """Filter a block of rows with all banks, and return the steps.

    A spike that the main bank leaves out becomes NaN in the block, so that no other bank uses it.
    """
    bank, others = session.bank, session.others
    assert bank is not None and others is not None
    states = _states_after(bank, session.state, _rows_of(session, block))
    session.state = states[-1]
    spikes = []
    for column, state in enumerate(states):
        if state.skipped.any():
            block[2:, column][state.skipped] = np.nan
            session.spikes += int(state.skipped.sum())
        spikes.append(session.spikes)
    if session.spectral is not None:
        take_in_frequency(session.spectral, block)
    rows = _rows_of(session, block)
    other_states = _states_after(others, session.others_state, rows)
    session.others_state = other_states[-1]
    final_states = most_likely_by_start(others, other_states, len(bank.delays))
    spread = start_spread(bank, states, final_states)
    refined: list[Relinearised | None] = [None] * len(states)
    if session.refine:
        refined = _refined(session, states, final_states, rows)
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
    steps = [WatchStep(*entries) for entries in columns]
    session.last = steps[-1]
    return steps


def _refined(
    session: Session, states: list[BankState], final_states: MostLikelyByStart, rows: Rows
) -> list[Relinearised | None]:
    """Return the relinearised bank after each row, None as long as there is none.

    The bank may be relinearised at the first row of each second.

    Parameters
    ----------
    states : states of the main bank after each row.
    final_states : states of the filters with other starts.
    """
    seconds = np.floor(rows.time)
    new_seconds = np.flatnonzero(np.diff(seconds, prepend=session.second) > 0).tolist()
    session.second = float(seconds[-1])
    after_rows: list[Relinearised | None] = []
    for row in [*new_seconds, len(states) - 1]:
        if row < len(after_rows):
            continue
        new_rows = slice(len(after_rows), row + 1)
        filtered: Sequence[Relinearised | None] = [None] * (row + 1 - len(after_rows))
        if session.refined is not None:
            filtered = advance_bank(session.refined, Rows(*(part[..., new_rows] for part in rows)))
        session.refined = filtered[-1]
        if row in new_seconds:
            if session.refined is not None:
                session.refined = with_fitting_grid(session.refined)
            if _is_due(session, states[row]):
                session.tried, first_before = states[row].rows_seen, session.first
                result = _linearised(session, states[row], final_states.mean[row].T)
                same_rows = session.refined is None or session.first == first_before
                if same_rows and result is not None:
                    session.refined = result
                else:
                    session.refined = bank_that_continues(session.refined, result, STARTED)
        after_rows += [*filtered[:-1], session.refined]
    return after_rows


def _is_due(session: Session, state: BankState) -> bool:
    """Return whether the bank is relinearised now: it has enough new rows and information."""
    assert session.bank is not None
    if state.rows_seen - session.first < ATTEMPT_GROWTH * (session.tried - session.first):
        return False
    if session.refined is None:
        return informative_enough(session.bank, state, STARTED)
    return linearisation_due(session.refined, STARTED)


def _linearised(
    session: Session, state: BankState, other_starts: np.ndarray
) -> Relinearised | None:
    """Return the bank linearised over the rows up to a state; None if that fails.

    Of many rows only the last are used, from a row at which the aircraft was steady.
    """
    assert session.bank is not None
    record, last = record_of(session), state.rows_seen
    if last - session.first > RELINEARISED_ROWS:
        earliest = last - RELINEARISED_ROWS
        if session.refined is None:
            session.first = onset(record, earliest)
        else:
            session.first = steadiest(record, earliest, last - RELINEARISED_ROWS // 2)
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
    """Return the row ``FEWEST_STARTING_ROWS`` before the stick moves, but not before ``first``."""
    stick = record["stick"].values[first:]
    distance = np.abs(stick - np.median(stick))
    moves = int(np.argmax(distance > STICK_MOTION_SHARE * distance.max()))
    return max(first, first + moves - FEWEST_STARTING_ROWS)


def steadiest(record: Record, first: int, last: int) -> int:
    """Return the row from ``first`` to before ``last`` at which the aircraft is steadiest.

    There the sum of the motion of the stick in the rows before and of the pitch rate is smallest,
    each as a share of its largest value.
    """
    stick, pitch_rate = record["stick"].values, np.zeros(len(record))
    if "q" in record.output_names:
        pitch_rate = np.abs(np.where(record["q"].valid, record["q"].values, np.inf))
    motion = np.ptp(np.lib.stride_tricks.sliding_window_view(stick, STEADY_STICK_ROWS), axis=1)
    rows = np.arange(max(first, STEADY_STICK_ROWS - 1), last)
    largest_stick, largest_rate = (
        max(float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0)), 1e-12)
        for values in (stick, pitch_rate)
    )
    stick_share = motion[rows - STEADY_STICK_ROWS + 1] / largest_stick
    return int(rows[np.argmin(stick_share + pitch_rate[rows] / largest_rate)])


def _states_after(bank: OnlineBank, state: BankState | None, rows: Rows) -> list[BankState]:
    """Return the state of a bank after each row; ``state``: before them, None at the start."""
    if state is not None:
        return advance(bank, state, rows)
    first = begin(bank, Rows(*(part[..., :1] for part in rows)))
    return [first, *advance(bank, first, Rows(*(part[..., 1:] for part in rows)))]


def _rows_of(session: Session, block: np.ndarray) -> Rows:
    """Return the rows of a block with stick and outputs as deviations from trim."""
    trim = [0.0, *(session.offsets.get(name, 0.0) for name in ("stick", *OUTPUTS))]
    about_trim = block - np.array(trim)[:, None]
    return Rows(about_trim[0], about_trim[1:2], about_trim[2:])


# ---- A watched stream: header, session, and dropped rows

STOPPED = "stopped by the user"
ROWS_PER_BATCH = 200  # rows filtered before results are written and shown


@dataclass
class Watch:
    """State of a watched stream.

    Attributes
    ----------
    name : name of the stream.
    vehicle_path : path of the vehicle file, or None.
    reference : results with which the estimates are compared, or None.
    choices, units : channel map, or None; unit by channel, from the sidecar.
    refine : whether the bank is relinearised.
    beside : name of the sidecar, empty without one.
    columns : names of the columns, if the header is missing or not used.
    rate : sampling rate of a stream without a clock, Hz.
    hold : inputs between rows in the regression; None: the more likely of the two holds.
    hold_from : words on the origin of the hold.
    signals : the signals that are read.
    omega : frequencies of the regression in the frequency domain, rad/s, or None.
    header : header of the stream, None before it arrives.
    session : banks of filters; only for the signals of the low-order equivalent system.
    order : state of the check of the rows' order.
    line : number of lines so far.
    left_out, mended : numbers of rows that were left out and filled in.
    reason : why the watch ended.
    heard : time at which the last line arrived, by the monotonic clock, s.
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


def rows_in(watch: Watch, new_lines: Lines) -> np.ndarray:
    """Return the rows of new CSV lines; the first line may be the header."""
    lines = new_lines.whole
    if lines:
        watch.heard = time.monotonic()
    while watch.header is None and lines:
        first = lines[0]
        without_header = bool(first.strip() and watch.columns) and is_row(first, watch.name)
        if not without_header:
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
    """Return the session of a stream with the signals of the low-order equivalent system.

    It has a regression in the frequency domain if that is requested and the stream has alpha and q.
    """
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
    """Yield rows in pieces of whole seconds: results must not depend on how the rows arrived.

    A piece is one second until the filters have started, then up to ``ROWS_PER_BATCH`` rows.
    """
    if session is None or not rows.size:
        return
    cuts = [*(np.flatnonzero(np.diff(np.floor(rows[0]))) + 1).tolist(), rows.shape[1]]
    first = 0
    while first < rows.shape[1]:
        ahead = [cut for cut in cuts if cut > first]
        last = ahead[0]
        if session.bank is not None:
            last = max((cut for cut in ahead if cut <= first + ROWS_PER_BATCH), default=last)
        yield rows[:, first:last]
        first = last


def session_of(watch: Watch) -> Session:
    """Return the session of a stream. Raises RecordError before its header came."""
    if watch.session is None:
        raise RecordError(
            "the stream is empty", where=watch.name, remedy="give a header row and one row a sample"
        )
    return watch.session


def report(watch: Watch, faults: list[Fault]) -> None:
    """Count rows that were left out or filled in, and print a line on the first of each."""
    for fault in faults:
        first = not (watch.left_out if fault.left_out else watch.mended)
        if first:
            left_out = "left out, " if fault.left_out else ""
            print(
                f"flightid: {watch.name}, row {fault.row}: {fault.what}; {left_out}"
                "others like it are counted",
                file=sys.stderr,
            )
        if fault.left_out:
            watch.left_out += 1
        else:
            watch.mended += 1


# ---- First figure of the page

STEM = "watched"  # file stem of the figure


def history_section(
    folder: Path, history: str, content: Mapping[str, Any], title: str, formats: Formats = USUAL
) -> tuple[Section, ...]:
    """Draw the figure of the parameters over time, and return the section of the page with it.

    Return no section if the history has fewer than two lines or no estimate, or without formats.

    Parameters
    ----------
    folder : receives the figure's files.
    history : text of ``history.csv``, with columns ``NAME`` and ``NAME_std``.
    content : content of ``comparison.json``, which names the parameters and the reference.
    title : title of the figure.
    formats : formats of the figure's files.
    """
    time, courses = courses_of(history, content["parameters"])
    if len(time) < 2 or not courses or not formats:
        return ()
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.estimates import figure_watched

    reference = {
        item["name"]: (item["reference"], item["reference_std"])
        for item in (content.get("reference") or {}).get("differences", ())
        if item.get("reference") is not None and item.get("reference_std") is not None
    }
    make = partial(figure_watched, time, courses, reference, title)
    figure_files = draw_for_page([(STEM, make)], folder, formats)
    return section("While the stream arrived", *figures(figure_files))


def courses_of(
    history: str, parameters: Mapping[str, Mapping[str, Any]]
) -> tuple[np.ndarray, dict[str, tuple[str, np.ndarray, np.ndarray]]]:
    """Return the times of a history, ``(N,)``, s, and each parameter over time.

    A parameter has its unit, values ``(N,)`` and standard deviations ``(N,)``; an empty cell is
    NaN. Refined estimates of a parameter come first if the history has them.
    """
    rows = list(csv.reader(io.StringIO(history)))
    if len(rows) < 2:
        return np.zeros(0), {}
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])
    columns = dict(zip(rows[0], table.T, strict=True))
    courses = {}
    for name, entry in parameters.items():
        key = f"refined_{name}" if f"refined_{name}" in columns else name
        if {key, f"{key}_std"} <= set(columns) and np.any(np.isfinite(columns[key])):
            courses[name] = str(entry["unit"]), columns[key], columns[f"{key}_std"]
    return columns["time"], courses
