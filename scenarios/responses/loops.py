"""Stability margins from the measured signals of a loop: of all records, of each maneuver, and of
the worst maneuver.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.flying_qualities.stability_margins import (
    REQUIRED_GAIN,
    REQUIRED_PHASE,
    LoopCurve,
    Margin,
    StabilityMargins,
    WorstMargin,
    loop_curve,
    stability_margins,
    turned,
    worst_margins,
)
from ident.frequency_response import FrequencyResponses
from scenarios.report.document import (
    BY_ROW,
    PURE,
    Column,
    Number,
    Table,
    formatted,
    table,
    value_and_width,
)
from scenarios.report.quantities import number_text
from scenarios.responses.fitting import target_of
from scenarios.responses.reading import Names, ReadSignals
from sim.errors import DeclarationError, FlightidError

MINUS, PLUS = "minus", "plus"
DIFFERING_P_VALUE = 0.05  # p-value below which maneuvers are said to differ
UNITS = {"gain": "dB", "phase": "deg", "delay": "s", "distance": "1"}  # kind of a margin -> unit
WORDS = {  # margin -> its name in words
    "gain_increase": "gain increase",
    "gain_decrease": "gain decrease",
    "phase_margin": "phase margin",
    "delay_margin": "delay margin",
    "distance": "least distance from -1",
}


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """Stability margins of a recorded loop.

    Attributes
    ----------
    name : ``"returned/command"``.
    sign : ``"minus"`` if the loop subtracts the returned signal, else ``"plus"``.
    curve, margins : loop response and margins of all parts together.
    parts : names of the parts (maneuvers) of the records; empty with a single part.
    maneuvers : margins of each part, None without an estimate.
    reasons : sentences on the parts without an estimate.
    worst : smallest value of each margin over the parts; empty with a single part.
    cautions : sentences on the result.
    contradicted : whether the signals show the opposite sign; the margins are then those of another
        loop.
    """

    name: str
    sign: str
    curve: LoopCurve
    margins: StabilityMargins
    parts: tuple[str, ...]
    maneuvers: tuple[StabilityMargins | None, ...]
    reasons: tuple[str, ...]
    worst: tuple[WorstMargin, ...]
    cautions: tuple[str, ...]
    contradicted: bool = False


def refuse_loop(sign: str | None, names: Names) -> None:
    """Raise DeclarationError without a sign, or if the signals are not a single loop."""
    if sign is None:
        return
    if sign not in (MINUS, PLUS):
        remedy = f"say {MINUS} where the loop subtracts what returns, {PLUS} where it adds it"
        raise DeclarationError(f"there is no sign {sign!r}", where="--margins", remedy=remedy)
    if len(names.inputs) != 1 or len(names.outputs) != 1:
        what = f"{len(names.inputs)} inputs and {len(names.outputs)} outputs are no single loop"
        remedy = "name the signal after the sum as --input, the one that returns as --output"
        raise DeclarationError(what, where="--margins", remedy=remedy)


def loop_margins_of(
    responses: FrequencyResponses,
    names: Names,
    sign: str | None,
    read: ReadSignals,
    estimate_part: Callable[[ReadSignals], FrequencyResponses],
) -> LoopMargins | None:
    """Return the margins of a loop; None without a ``sign`` or a usable band.

    Parameters
    ----------
    responses : frequency response of the loop from all parts.
    names : names of the signals.
    sign : sign with which the loop feeds the returned signal back.
    read : the signals of all parts.
    estimate_part : estimates the response of a single part in the same way.
    """
    if sign is None or not responses.usable[0, 0].any():
        return None
    name = f"{names.outputs[0]}/{names.inputs[0]}"

    def margins_of(response: FrequencyResponses) -> tuple[LoopCurve, StabilityMargins]:
        target = target_of(response, (0, 0), name)
        if sign == PLUS:
            target = turned(target)
        return loop_curve(target), stability_margins(target)

    curve, margins = margins_of(responses)
    parts = read.names if len(read.signals) > 1 else ()
    maneuvers: list[StabilityMargins | None] = []
    reasons: list[str] = []
    for number, part in enumerate(parts):
        chosen = slice(number, number + 1)
        single = replace(
            read, signals=read.signals[chosen], names=(part,), durations=read.durations[chosen]
        )
        part_margins = None
        try:
            response = estimate_part(single)
            if response.usable[0, 0].any():
                part_margins = margins_of(response)[1]
            else:
                reasons.append(f"{part}: no usable band by itself")
        except FlightidError as error:
            reasons.append(f"{part}: no margins by itself: {error.what}")
        maneuvers.append(part_margins)
    numbers = [number for number, item in enumerate(maneuvers) if item is not None]
    determined = [item for item in maneuvers if item is not None]
    worst = worst_margins(determined) if determined else ()
    worst = tuple(replace(item, maneuver=numbers[item.maneuver]) for item in worst)
    contradicted = responses.joint and fitting_sign(_products(read)) not in (sign, None)
    cautions = _cautions(responses, names, sign, worst, contradicted=contradicted)
    return LoopMargins(
        name,
        sign,
        curve,
        margins,
        parts,
        tuple(maneuvers),
        tuple(reasons),
        worst,
        cautions,
        contradicted,
    )


def _cautions(
    responses: FrequencyResponses,
    names: Names,
    sign: str,
    worst: Sequence[WorstMargin],
    *,
    contradicted: bool,
) -> tuple[str, ...]:
    """Return cautions on the margins, one sentence each."""
    cautions = []
    if not responses.joint:
        cautions.append(
            "margins from the direct estimate: what noise and turbulence bring back through the "
            "loop biases them; record the excitation and name it with --reference"
        )
    elif contradicted:
        cautions.append(sign_caution(names.references[0], names.inputs[0], names.outputs[0], sign))
    for item in worst:
        if item.p_value < DIFFERING_P_VALUE:
            cautions.append(
                f"{WORDS[item.name]}: the maneuvers differ by more than chance (p = "
                f"{item.p_value:.2g}); go by the worst one"
            )
    return tuple(cautions)


def _products(read: ReadSignals) -> np.ndarray:
    """Return the sums of products ``(3, 3)`` of reference, command and returned signal about their
    means in each part.
    """
    parts = [np.concatenate([part.references, part.inputs, part.outputs]) for part in read.signals]
    centred = [rows - rows.mean(axis=1, keepdims=True) for rows in parts]
    return np.asarray(sum(rows @ rows.T for rows in centred))


def fitting_sign(products: np.ndarray) -> str | None:
    """Return the sign of the feedback according to the signals; None if undecided.

    The reference is regressed on command and returned signal. If the loop subtracts, reference =
    command + returned: both coefficients have the same sign.

    Parameters
    ----------
    products : sums of products ``(3, 3)`` of reference, command and returned signal about their
        means.
    """
    command, returned = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=None)[0]
    product = command * returned
    if product == 0.0:
        return None
    return MINUS if product > 0.0 else PLUS


def sign_caution(reference: str, command: str, returned: str, sign: str) -> str:
    """Return a caution that the signals contradict the declared ``sign``."""
    other = PLUS if sign == MINUS else MINUS
    return (
        f"{reference} is closer to {command} {'+' if other == MINUS else '-'} {returned}: "
        f"--margins {other} fits these signals, and these margins are those of another loop"
    )


def loop_tables(loop: LoopMargins) -> list[Table]:
    """Return tables of the margins of all parts together, and of the worst maneuver."""
    sign = "-" if loop.sign == MINUS else "+"
    title = f"Stability margins of {loop.name}, a loop with command = excitation {sign} returned"
    names, margins = list(loop.margins.named), list(loop.margins.named.values())
    frequencies = [margin.frequency.value for margin in margins]
    sizes = [
        value_and_width(margin.size.value, 0.5 * (margin.high - margin.low))[0]
        for margin in margins
    ]
    hertz = [frequency / (2.0 * math.pi) for frequency in frequencies]
    together = table(
        title,
        (Column("margin"), [WORDS[name] for name in names]),
        (Column("value", BY_ROW), sizes),
        (Column("95 %", right=True), [interval_text(margin) for margin in margins]),
        (Column("at", "rad/s", printed="at rad/s"), [formatted(f, ".3g") for f in frequencies]),
        (Column("at", "Hz", printed="Hz"), [formatted(f, ".3g") for f in hertz]),
        units=[UNITS[margin.kind] for margin in margins],
    )
    worst_sizes = [value_and_width(item.margin.size.value, item.half) for item in loop.worst]
    counts = [sum(value is not None for value in item.values) for item in loop.worst]
    worst = table(
        "The worst maneuver, intervals for all together",
        (Column("worst of"), [WORDS[item.name] for item in loop.worst]),
        (Column("value", BY_ROW), [size for size, _ in worst_sizes]),
        (Column("+-", BY_ROW, beside=True), [half for _, half in worst_sizes]),
        (Column("maneuver"), [loop.parts[item.maneuver] for item in loop.worst]),
        (Column("maneuvers", PURE), [Number(count, digits=0) for count in counts]),
        (
            Column("p of no difference", PURE),
            [formatted(item.p_value, ".2g") for item in loop.worst],
        ),
        units=[UNITS[item.margin.kind] for item in loop.worst],
    )
    return [shown for shown in (together, worst) if shown.rows]


def interval_text(margin: Margin) -> str:
    """Return ``"4.5 to 4.8"``, with ``or wider`` if the usable band ends within the interval."""
    half = 0.5 * (margin.high - margin.low)
    low, high = (
        number_text(end, half) if math.isfinite(half) else f"{end:.3g}"
        for end in (margin.low, margin.high)
    )
    text = f"{low} to {high}"
    return f"{text} or wider" if margin.open else text


def margin_lines(loop: LoopMargins) -> list[str]:
    """Return sentences that compare the margins with the required ones, and notes."""
    named = loop.margins.named
    requirements = [
        ("gain_increase", REQUIRED_GAIN, "dB"),
        ("gain_decrease", REQUIRED_GAIN, "dB"),
        ("phase_margin", REQUIRED_PHASE, "deg"),
    ]
    comparisons = [
        f"{WORDS[name]} of {required:g} {unit} {_verdict(named[name], required)}"
        for name, required, unit in requirements
        if name in named
    ]
    lines = []
    if loop.contradicted:
        lines.append("not compared with MIL-F-9490D: the signals contradict the sign of the loop")
    elif comparisons:
        lines.append(
            "MIL-F-9490D, below the first structural mode, with the 95 % intervals: "
            f"{', '.join(comparisons)}"
        )
    return [*lines, *loop.margins.notes, *loop.reasons]


def _verdict(margin: Margin, required: float) -> str:
    """Return whether the 95 % interval of a margin meets a requirement."""
    low, high = margin.low, margin.high
    if low * high > 0.0:  # a gain decrease is negative
        low, high = abs(low), abs(high)
    low, high = sorted((low, high))
    if low >= required and not margin.open:
        return "met"
    return "not met" if high < required else "undecided"


def margins_content(loop: LoopMargins) -> dict[str, object]:
    """Return the margins for ``responses.json``."""
    content: dict[str, object] = {
        "response": loop.name,
        "sign": loop.sign,
        "pooled": {name: _margin_content(margin) for name, margin in loop.margins.named.items()},
        "gain_crossings": [_margin_content(margin) for margin in loop.margins.phases],
        "phase_crossings": [_margin_content(margin) for margin in loop.margins.gains],
        "notes": [*loop.margins.notes, *loop.reasons],
    }
    if loop.parts:
        content["maneuvers"] = [
            {"name": part, **_margins_content(margins)}
            for part, margins in zip(loop.parts, loop.maneuvers, strict=True)
        ]
        content["worst"] = {
            item.name: {
                "value": item.margin.size.value,
                "half_width": item.half,
                "maneuver": loop.parts[item.maneuver],
                "p_alike": item.p_value,
            }
            for item in loop.worst
        }
    return content


def _margins_content(margins: StabilityMargins | None) -> dict[str, object]:
    """Return the margins of a part; empty without an estimate."""
    named = margins.named if margins is not None else {}
    return {name: _margin_content(margin) for name, margin in named.items()}


def _margin_content(margin: Margin) -> dict[str, object]:
    """Return a margin for ``responses.json``."""
    return {
        "value": margin.size.value,
        "std": margin.size.std,
        "low": margin.low,
        "high": margin.high,
        **({"reaches_band_end": True} if margin.open else {}),
        "unit": UNITS[margin.kind],
        "frequency": margin.frequency.value,
    }
