"""Stability margins of a loop in a stream: an estimate for every second while it arrives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.flying_qualities.stability_margins import (
    CONFIDENCE,
    NORMAL_HALF_WIDTH,
    Margin,
    StabilityMargins,
    loop_curve,
    stability_margins,
    turned,
)
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.estimate import (
    FEWEST_SAMPLES_PER_PERIOD,
    RANDOM_ERROR,
    frequencies,
    longest_run,
    window_lengths,
)
from ident.frequency_response.online import (
    OnlineResponses,
    add_samples,
    estimated,
    interrupt,
    online_responses,
)
from ident.frequency_response.transfer_function import ResponseTarget
from scenarios.files.declarations import CHANNEL_UNITS, TIME
from scenarios.files.sources import versions
from scenarios.responses.fitting import target_of
from scenarios.responses.loops import (
    MINUS,
    UNITS,
    WORDS,
    LoopMargins,
    fitting_sign,
    interval_text,
    margins_content,
    refuse_loop,
    sign_caution,
)
from scenarios.responses.reading import Names
from scenarios.watching.rows import StreamSignals
from sim.errors import DeclarationError, RecordError

LOWEST_FREQUENCY, HIGHEST_FREQUENCY = 0.2, 10.0  # Hz, usual band
STARTING_TIME = 2.0  # s of rows from which the rate is determined
FEWEST_STARTING_ROWS = 4
FEWEST_FREQUENCIES = 3  # usable frequencies from which margins are computed
WINDOW_PERIODS = 2.5  # periods of the lowest frequency in the longest window, as in `response`
CROSSING_DISTANCE = 0.1  # least distance of a crossing from the ends of the band, in ln(omega)
LARGEST_BRIDGED_GAP = 0.1  # longest interpolated gap, share of the shortest period
ROUNDING = 1e-9  # s, rounding errors of times
SCHEMA = "flightid/margins/1"
MAIN, HISTORY = "margins.json", "history.csv"


@dataclass(frozen=True)
class LoopNames:
    """The signals of a loop.

    Attributes
    ----------
    sign : sign with which the sum takes the returned signal, ``"minus"`` or ``"plus"``.
    command : signal after the sum.
    returned : signal that returns into the sum.
    excitation : signal that is added in the sum; None if it is not recorded.
    """

    sign: str
    command: str
    returned: str
    excitation: str | None = None

    @property
    def signals(self) -> StreamSignals:
        """Channels to read from a stream, in the units of its columns."""
        inputs = (self.command, *([self.excitation] if self.excitation else []))
        units = {name: CHANNEL_UNITS.get(name, "") for name in (*inputs, self.returned)}
        return StreamSignals(inputs, (self.returned,), {TIME: "s", **units})

    @property
    def name(self) -> str:
        """Name of the broken-loop response: ``"returned/command"``."""
        return f"{self.returned}/{self.command}"


def loop_names(
    sign: str, inputs: Sequence[str], outputs: Sequence[str], excitation: str | None
) -> LoopNames:
    """Return the names of a loop's signals; raise DeclarationError for signals of several loops."""
    references = (excitation,) if excitation else ()
    refuse_loop(sign, Names(tuple(inputs), tuple(outputs), references))
    return LoopNames(sign, inputs[0], outputs[0], excitation)


@dataclass(frozen=True, eq=False)
class MarginPoint:
    """Margins after a second of the stream.

    Attributes
    ----------
    time : time, s.
    margins : the margins; None without a usable band.
    band : usable band, rad/s, or None.
    """

    time: float
    margins: StabilityMargins | None
    band: tuple[float, float] | None


@dataclass
class MarginSession:
    """State of an on-line estimate of loop margins; ``take`` changes it.

    Attributes
    ----------
    names : signals of the loop.
    name : name of the stream.
    band : requested band, Hz; None for the usual one.
    stream, step : the recursive transforms and the sampling interval (s), once the rate is known.
    waiting : rows ``(1 + S, N)`` of an incomplete second.
    last : the last row.
    rows : number of rows.
    gaps : number of gaps that were too long to interpolate.
    points : margins, one per second.
    responses : the last estimate of the response.
    begun : time of the first row, s.
    moments : sums of products ``(4, 4)`` of the number 1, excitation, command and returned signal.
    """

    names: LoopNames
    name: str
    band: tuple[float, float] | None = None
    stream: OnlineResponses | None = None
    step: float = 0.0
    waiting: list[np.ndarray] = field(default_factory=list)
    last: np.ndarray | None = None
    rows: int = 0
    gaps: int = 0
    points: list[MarginPoint] = field(default_factory=list)
    responses: FrequencyResponses | None = None
    begun: float | None = None
    moments: np.ndarray = field(default_factory=lambda: np.zeros((4, 4)))


def take(session: MarginSession, rows: np.ndarray) -> list[MarginPoint]:
    """Process new rows and return the margins after each second that is complete.

    Results do not depend on the pieces in which rows arrive.

    Parameters
    ----------
    session : the state.
    rows : rows ``(1 + S, N)``: time, command, excitation if there is one, returned signal.
    """
    if not rows.shape[1]:
        return []
    if session.begun is None:
        session.begun = float(rows[0, 0])
    cuts = np.flatnonzero(np.diff(np.floor(rows[0] - session.begun + ROUNDING))) + 1
    points = []
    for part in np.split(rows, cuts, axis=1):
        if session.waiting:
            before = session.waiting[-1][0, -1] - session.begun + ROUNDING
            if np.floor(part[0, 0] - session.begun + ROUNDING) > np.floor(before):
                points += finish_second(session)
        session.waiting.append(part)
    return points


def finish_second(session: MarginSession) -> list[MarginPoint]:
    """Process the waiting rows and return the margins after them; an empty list if the rate is not
    known yet.
    """
    if not session.waiting:
        return []
    block = np.concatenate(session.waiting, axis=1)
    if session.stream is None:
        duration = block[0, -1] - block[0, 0]
        if duration < STARTING_TIME or block.shape[1] < FEWEST_STARTING_ROWS:
            return []
        _begin(session, block)
    session.waiting = []
    assert session.stream is not None
    for samples, lost in _even_samples(session, block):
        if lost:
            session.gaps += 1
            interrupt(session.stream, lost)
        add_samples(session.stream, samples)
    session.rows += block.shape[1]
    if session.names.excitation:
        sound = block[:, np.all(np.isfinite(block), axis=0)]
        signals = np.stack([np.ones(sound.shape[1]), sound[2], sound[1], sound[-1]])
        session.moments = session.moments + signals @ signals.T
    session.responses = estimated(session.stream)
    session.points.append(_point(session, float(block[0, -1])))
    return session.points[-1:]


def _begin(session: MarginSession, block: np.ndarray) -> None:
    """Start the recursive transforms, with the rate of the first rows."""
    session.step = float(np.median(np.diff(block[0])))
    low, high = session.band or (
        LOWEST_FREQUENCY,
        min(HIGHEST_FREQUENCY, 1.0 / (FEWEST_SAMPLES_PER_PERIOD * session.step)),
    )
    if not (0.0 < low < high and math.isfinite(high)):
        what = f"{low:g} to {high:g} Hz is no band"
        raise DeclarationError(what, where="--band", remedy="give LOW HIGH in Hz, above 0")
    lengths = window_lengths([2.0 * WINDOW_PERIODS / low], low)
    session.stream = online_responses(
        session.step, frequencies(low, high), lengths, joint=session.names.excitation is not None
    )


def _even_samples(session: MarginSession, block: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Return stretches of evenly sampled signals, each with the number of samples lost before it.

    The rows of a stretch are returned signal, command and excitation. Gaps up to
    ``LARGEST_BRIDGED_GAP`` are interpolated.
    """
    assert session.stream is not None
    kept = block[:, np.all(np.isfinite(block), axis=0)]
    if session.last is not None:
        kept = np.concatenate([session.last[:, None], kept], axis=1)
    if kept.shape[1] < 2 and session.last is not None:
        return []
    session.last = kept[:, -1].copy() if kept.shape[1] else None
    if not kept.shape[1]:
        return []
    time, values = kept[0], kept[[-1, *range(1, kept.shape[0] - 1)]]
    steps = np.maximum(np.round(np.diff(time) / session.step).astype(int), 1)
    longest = max(
        2, int(LARGEST_BRIDGED_GAP / (float(session.stream.frequency[-1]) * session.step)) + 1
    )
    # The first row of a later block is the last row of the block before.
    first = 0 if session.stream.samples == 0 else 1
    stretches, lost = [], 0
    for end in [*(np.flatnonzero(steps > longest) + 1).tolist(), time.size]:
        if end > first:
            places = np.concatenate([[0], np.cumsum(steps[first : end - 1])])
            step_before = steps[first - 1] if first and not lost else 1
            grid = np.arange(1 - step_before if first else 0, places[-1] + 1)
            rows = values[:, first:end]
            if step_before > 1:
                places = np.concatenate([[-step_before], places])
                rows = values[:, first - 1 : end]
            stretches.append((np.array([np.interp(grid, places, row) for row in rows]), lost))
        first, lost = end, int(steps[end - 1]) - 1 if end < time.size else 0
    return stretches


def _target(session: MarginSession) -> ResponseTarget | None:
    """Return the broken-loop response in its usable band; None if this has too few frequencies.

    At first, a stream has few windows. So sigmas are widened to Student's distribution. A usable
    frequency needs not only its coherence but also a random error of at most 20 % (Tischler and
    Remple, chapter 9): two windows are always coherent.
    """
    from scipy.stats import t

    responses = session.responses
    if responses is None:
        return None
    widening = t.ppf(0.5 * (1.0 + CONFIDENCE), responses.degrees) / NORMAL_HALF_WIDTH
    responses = replace(responses, std=responses.std * widening[:, None, :])
    precise = responses.usable[0, 0] & (responses.random_error[0, 0] <= RANDOM_ERROR)
    usable = longest_run(precise, np.log(responses.frequency))
    if np.count_nonzero(usable) < FEWEST_FREQUENCIES:
        return None
    target = target_of(replace(responses, usable=usable[None, None]), (0, 0), session.names.name)
    return target if session.names.sign == MINUS else turned(target)


def _point(session: MarginSession, time: float) -> MarginPoint:
    """Return the margins at a time, s."""
    target = _target(session)
    if target is None:
        return MarginPoint(time, None, None)
    band = float(target.omega[0]), float(target.omega[-1])
    margins = _inside(stability_margins(target), *band)
    if margins.gain_increase is None and margins.phase is None:
        # Without a crossing in the band, the least distance from -1 is outside it.
        margins = replace(margins, distance=None)
    return MarginPoint(time, margins, band)


def _inside(margins: StabilityMargins, low: float, high: float) -> StabilityMargins:
    """Return the margins whose crossings are well inside the usable band.

    Near an end of the band, the response is known on one side of the crossing only. The excitation
    has just reached the outermost frequencies: their errors are larger than their sigmas.
    """
    distance = math.exp(CROSSING_DISTANCE)

    def is_inside(margin: Margin) -> bool:
        return low * distance <= margin.frequency.value <= high / distance

    notes = tuple(
        f"a {margin.kind} margin near {margin.frequency.value / math.tau:.3g} Hz lies at an end of "
        "the usable band and is left out"
        for margin in (*margins.gains, *margins.phases)
        if not is_inside(margin)
    )
    delay, least_distance = margins.delay, margins.distance
    return StabilityMargins(
        tuple(margin for margin in margins.gains if is_inside(margin)),
        tuple(margin for margin in margins.phases if is_inside(margin)),
        delay if delay is not None and is_inside(delay) else None,
        least_distance if least_distance is not None and is_inside(least_distance) else None,
        (*margins.notes, *notes),
    )


def margins_of(session: MarginSession) -> LoopMargins | None:
    """Return the margins after the last row; None if no frequency is usable."""
    last = session.points[-1] if session.points else None
    target = _target(session)
    if last is None or last.margins is None or target is None:
        return None
    contradicted, names = _contradicted(session), session.names
    cautions: tuple[str, ...] = ()
    if not names.excitation:
        cautions = (
            "margins from the direct estimate: what noise and turbulence bring back through the "
            "loop biases them; stream the excitation and name it with --excitation",
        )
    if contradicted and names.excitation is not None:
        cautions = (sign_caution(names.excitation, names.command, names.returned, names.sign),)
    curve = loop_curve(target)
    # A stream has a single part, so there are no maneuvers to compare.
    return LoopMargins(
        names.name, names.sign, curve, last.margins, (), (), (), (), cautions, contradicted
    )


def _contradicted(session: MarginSession) -> bool:
    """Return whether the stream shows that the loop has the opposite sign."""
    sums = session.moments
    if not sums[0, 0] > 0.0:
        return False
    products = sums[1:, 1:] - np.outer(sums[1:, 0], sums[0, 1:]) / sums[0, 0]
    return fitting_sign(products) not in (session.names.sign, None)


def shown(point: MarginPoint) -> list[tuple[str, Margin]]:
    """Return the margins of a point, by name."""
    return [] if point.margins is None else list(point.margins.named.items())


def line(session: MarginSession, point: MarginPoint, left_out: int) -> str:
    """Return a second of the stream in one line, with 95 % intervals."""
    texts = [
        f"{WORDS[name]} {margin.size.value:.3g} ({interval_text(margin)}) {UNITS[margin.kind]}"
        for name, margin in shown(point)
        if margin.kind != "distance"
    ]
    lost = f", {left_out} line{'s' * (left_out != 1)} left out" if left_out else ""
    text = "; ".join(texts) or "no margin is determined"
    return f"{session.name}, {point.time:.2f} s{lost}: {text}"


def history_csv(session: MarginSession) -> str:
    """Return the history as CSV, a line for each second.

    The columns are ``time``, the usable band, and for each margin its value, the limits of its
    95 % interval and its frequency. Cells of an undetermined margin are empty.
    """
    suffixes = ("", "_low", "_high", "_frequency")
    header = ["time", "band_low", "band_high"]
    header += [f"{name}{suffix}" for name in WORDS for suffix in suffixes]
    lines = [",".join(header)]
    for point in session.points:
        margins = dict(shown(point))
        cells = [f"{point.time:.10g}"]
        cells += [f"{end:.6g}" for end in point.band] if point.band else ["", ""]
        for name in WORDS:
            if name not in margins:
                cells += [""] * len(suffixes)
                continue
            margin = margins[name]
            values = (margin.size.value, margin.low, margin.high, margin.frequency.value)
            cells += [f"{value:.6g}" for value in values]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def margin_content(session: MarginSession) -> dict[str, Any]:
    """Return the content of ``margins.json``, without the entries on the stream."""
    loop = margins_of(session)
    stream = session.stream
    warnings = list(loop.cautions) if loop else ["no frequency is usable: no margin is determined"]
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": "watch",
        "response": session.names.name,
        "sign": session.names.sign,
        "method": "joint input-output" if session.names.excitation else "direct",
        "warnings": warnings,
        "versions": versions(),
    }
    if stream is not None:
        ends = stream.frequency[[0, -1]].tolist()
        content |= {
            "band_Hz": ends,
            "rate_Hz": 1.0 / stream.step,
            "windows_s": list(stream.spectra.windows),
            "memory_s": stream.memory,
        }
    if loop is not None:
        content["margins"] = margins_content(loop)
    return content


def refuse_short(session: MarginSession) -> None:
    """Raise RecordError if the stream was too short to determine its rate."""
    if session.stream is None:
        what = f"less than {STARTING_TIME:g} s of rows that can be used"
        raise RecordError(what, where=session.name, remedy="stream a longer maneuver")
