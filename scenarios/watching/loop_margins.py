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
from ident.frequency_response.online import OnlineResponses, estimated, interrupt, online_responses
from ident.frequency_response.online import take as take_samples
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

LOWEST_FREQUENCY = 0.2  # Hz
HIGHEST_FREQUENCY = 10.0  # Hz
STARTING_TIME = 2.0  # s of rows that determine the rate
# least distance of a crossing from the band's end, in ln(omega), for a margin to be shown
CROSSING_DISTANCE = 0.1
# longest interpolated gap, share of the shortest period
LARGEST_BRIDGED_GAP = 0.1
SCHEMA = "flightid/margins/1"
MAIN, HISTORY = "margins.json", "history.csv"


@dataclass(frozen=True)
class LoopNames:
    """The signals of a loop: ``command`` after the sum, ``returned`` into it with ``sign``, and
    the ``excitation`` that is added; None if it is not recorded."""

    sign: str
    command: str
    returned: str
    excitation: str | None = None

    @property
    def signals(self) -> StreamSignals:
        """Channels to read from a stream; units of columns stay as they are."""
        inputs = (self.command, *([self.excitation] if self.excitation else []))
        units = {name: CHANNEL_UNITS.get(name, "") for name in (*inputs, self.returned)}
        return StreamSignals(inputs, (self.returned,), {TIME: "s", **units})

    @property
    def name(self) -> str:
        """``"returned/command"``."""
        return f"{self.returned}/{self.command}"


def loop_names(
    sign: str, inputs: Sequence[str], outputs: Sequence[str], excitation: str | None
) -> LoopNames:
    """Return the names of a loop's signals.

    Raises DeclarationError if they are no single loop.
    """
    references = (excitation,) if excitation else ()
    refuse_loop(sign, Names(tuple(inputs), tuple(outputs), references))
    return LoopNames(sign, inputs[0], outputs[0], excitation)


@dataclass(frozen=True, eq=False)
class MarginPoint:
    """Margins after a second of the stream: ``time`` s; ``band`` rad/s, usable; None if no
    frequency is."""

    time: float
    margins: StabilityMargins | None
    band: tuple[float, float] | None


@dataclass
class MarginSession:
    """State of an on-line estimate of loop margins; ``take`` changes it.

    Attributes
    ----------
    band : Hz, as requested.
    stream, step : the recursive transforms and sample interval (s), once the rate is known.
    waiting : rows ``(1 + S, N)`` of an incomplete second.
    last : the last row.
    gaps : number of gaps that were too long to interpolate.
    points : margins, one per second.
    moments : sums of products of one, excitation, command and returned signal.
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
    """Take rows ``(1 + S, N)``: time, command, excitation if there is one, returned; the margins
    of the seconds that are over, whatever pieces the rows came in."""
    if not rows.shape[1]:
        return []
    if session.begun is None:
        session.begun = float(rows[0, 0])
    cuts = np.flatnonzero(np.diff(np.floor(rows[0] - session.begun + 1e-9))) + 1
    out = []
    for part in np.split(rows, cuts, axis=1):
        if session.waiting:
            before = session.waiting[-1][0, -1] - session.begun + 1e-9
            if np.floor(part[0, 0] - session.begun + 1e-9) > np.floor(before):
                out += finish_second(session)
        session.waiting.append(part)
    return out


def finish_second(session: MarginSession) -> list[MarginPoint]:
    """Take the rows that wait into the transforms; the margins after them, none while the rate is
    not known yet."""
    if not session.waiting:
        return []
    block = np.concatenate(session.waiting, axis=1)
    if session.stream is None:
        if block[0, -1] - block[0, 0] < STARTING_TIME or block.shape[1] < 4:
            return []
        _begin(session, block)
    session.waiting = []
    assert session.stream is not None
    for samples, lost in _even(session, block):
        if lost:
            session.gaps += 1
            interrupt(session.stream, lost)
        take_samples(session.stream, samples)
    session.rows += block.shape[1]
    if session.names.excitation:
        sound = block[:, np.all(np.isfinite(block), axis=0)]
        signals = np.stack([np.ones(sound.shape[1]), sound[2], sound[1], sound[-1]])
        session.moments = session.moments + signals @ signals.T
    session.responses = estimated(session.stream)
    session.points.append(_point(session, float(block[0, -1])))
    return session.points[-1:]


def _begin(session: MarginSession, block: np.ndarray) -> None:
    """Open the transforms, with the rate that the first rows have."""
    session.step = float(np.median(np.diff(block[0])))
    low, high = session.band or (
        LOWEST_FREQUENCY,
        min(HIGHEST_FREQUENCY, 1.0 / (FEWEST_SAMPLES_PER_PERIOD * session.step)),
    )
    if not (0.0 < low < high and math.isfinite(high)):
        what, remedy = (
            f"{low:g} to {high:g} Hz is no band",
            "give LOW HIGH in Hz, above 0",
        )
        raise DeclarationError(what, where="--band", remedy=remedy)
    # The longest window holds two and a half periods of the lowest frequency, as in `response`.
    lengths = window_lengths([2.0 * 2.5 / low], low)
    session.stream = online_responses(
        session.step, frequencies(low, high), lengths, joint=session.names.excitation is not None
    )


def _even(session: MarginSession, block: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Samples at even steps, each stretch with the number of those that were lost before it.

    Rows: returned, command, excitation. What is missing is joined by lines where it is shorter than
    a tenth of a period of the highest frequency.
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
    first = 0 if session.stream.samples == 0 else 1
    out, at, lost = [], first, 0
    for cut in [*(np.flatnonzero(steps > longest) + 1).tolist(), time.size]:
        stretch = slice(at, cut)
        if cut > at:
            places = np.concatenate([[0], np.cumsum(steps[at : cut - 1])])
            before = steps[at - 1] if at and not lost else 1
            grid = np.arange(1 - before if at else 0, places[-1] + 1)
            known, rows = places, values[:, stretch]
            if before > 1:
                known = np.concatenate([[-before], places])
                rows = values[:, at - 1 : cut]
            out.append((np.array([np.interp(grid, known, row) for row in rows]), lost))
        at, lost = cut, int(steps[cut - 1]) - 1 if cut < time.size else 0
    return out


def _target(session: MarginSession) -> ResponseTarget | None:
    """The broken-loop response along its usable band; None if that has less than three points.

    A stream has few windows of a frequency at first. Deviations are widened to Student's
    distribution, and besides its coherence a frequency needs a random error of at most 20 %
    (Tischler and Remple, chapter 9): two windows are coherent whatever they hold.
    """
    from scipy.stats import t

    responses = session.responses
    if responses is None:
        return None
    wide = t.ppf(0.5 * (1.0 + CONFIDENCE), responses.degrees) / NORMAL_HALF_WIDTH
    responses = replace(responses, std=responses.std * wide[:, None, :])
    good = responses.usable[0, 0] & (responses.random_error[0, 0] <= RANDOM_ERROR)
    usable = longest_run(good, np.log(responses.frequency))
    if np.count_nonzero(usable) < 3:
        return None
    target = target_of(replace(responses, usable=usable[None, None]), (0, 0), session.names.name)
    return target if session.names.sign == MINUS else turned(target)


def _point(session: MarginSession, time: float) -> MarginPoint:
    target = _target(session)
    if target is None:
        return MarginPoint(time, None, None)
    band = float(target.omega[0]), float(target.omega[-1])
    margins = _inside(stability_margins(target), *band)
    if margins.gain_increase is None and margins.phase is None:
        # No crossing in the band yet; the least distance lies beyond it.
        margins = replace(margins, distance=None)
    return MarginPoint(time, margins, band)


def _inside(margins: StabilityMargins, low: float, high: float) -> StabilityMargins:
    """Return the margins whose crossings lie well inside the usable band.

    At an end of the band points lie on one side of the crossing alone, and the outermost are those
    that the excitation has only just reached: their errors are larger than their deviations.
    """
    inside = math.exp(CROSSING_DISTANCE)

    def kept(margin: Margin) -> bool:
        return low * inside <= margin.frequency.value <= high / inside

    left = [each for each in (*margins.gains, *margins.phases) if not kept(each)]
    notes = tuple(
        f"a {each.kind} margin near {each.frequency.value:.3g} rad/s lies at an end of the usable "
        "band and is left out"
        for each in left
    )
    return StabilityMargins(
        tuple(each for each in margins.gains if kept(each)),
        tuple(each for each in margins.phases if kept(each)),
        margins.delay if margins.delay is not None and kept(margins.delay) else None,
        margins.distance if margins.distance is not None and kept(margins.distance) else None,
        (*margins.notes, *notes),
    )


def margins_of(session: MarginSession) -> LoopMargins | None:
    """Return the margins after the last row; None if no frequency is usable."""
    last = session.points[-1] if session.points else None
    target = _target(session)
    if last is None or last.margins is None or target is None:
        return None
    cautions = (
        ()
        if session.names.excitation
        else (
            "margins from the direct estimate: what noise and turbulence bring back through the "
            "loop biases them; stream the excitation and name it with --excitation",
        )
    )
    other, names = _contradicted(session), session.names
    if other and names.excitation is not None:
        cautions = (sign_caution(names.excitation, names.command, names.returned, names.sign),)
    return LoopMargins(
        session.names.name,
        session.names.sign,
        loop_curve(target),
        last.margins,
        (),
        (),
        (),
        (),
        cautions,
        other,
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
    """A line for each second: ``time``, the usable band, and of each margin its value, the ends of
    its 95 % interval and its frequency; empty if it is not determined."""
    head = ["time", "band_low", "band_high"]
    head += [f"{name}{part}" for name in WORDS for part in ("", "_low", "_high", "_frequency")]
    lines = [",".join(head)]
    for point in session.points:
        known = dict(shown(point))
        cells = [f"{point.time:.10g}"]
        cells += [f"{end:.6g}" for end in point.band] if point.band else ["", ""]
        for name in WORDS:
            if name not in known:
                cells += [""] * 4
                continue
            one = known[name]
            cells += [
                f"{value:.6g}" for value in (one.size.value, one.low, one.high, one.frequency.value)
            ]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def margin_content(session: MarginSession) -> dict[str, Any]:
    """Return the content of ``margins.json`` without the stream's."""
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
    """Raise RecordError if the rate was never known."""
    if session.stream is None:
        what = f"less than {STARTING_TIME:g} s of rows that can be used"
        raise RecordError(what, where=session.name, remedy="stream a longer maneuver")
