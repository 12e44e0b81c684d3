"""Stability margins from the measured signals of a loop: pooled, by maneuver, and the worst of
them.
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
from scenarios.report.document import BY_ROW, PURE, Column, Number, Table, formatted, table
from scenarios.responses.fitting import target_of
from scenarios.responses.reading import Names, ReadSignals
from sim.errors import DeclarationError, FlightidError

MINUS, PLUS = "minus", "plus"
DIFFERING_P_VALUE = 0.05  # chance below which maneuvers are said to differ
UNITS = {"gain": "dB", "phase": "deg", "delay": "s", "distance": "1"}
WORDS = {
    "gain_increase": "gain increase",
    "gain_decrease": "gain decrease",
    "phase_margin": "phase margin",
    "delay_margin": "delay margin",
    "distance": "least distance from -1",
}


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """Margins of the loop that the records hold.

    Attributes
    ----------
    name : ``"returned/command"``.
    sign : ``"minus"`` if the returned signal is subtracted.
    curve, margins : of all records together.
    maneuvers : margins of each part, None without an estimate; ``parts``: names of the parts,
        ``reasons``: why there is no estimate, by name.
    worst : smallest value of each margin over the parts; empty with one part.
    cautions : on the result.
    contradicted : the signals have the opposite sign; the margins are then those of another loop.
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
    again: Callable[[ReadSignals], FrequencyResponses],
) -> LoopMargins | None:
    """Return the margins of a loop; None without a ``sign``.

    ``again`` : estimates the response of one part in the same way.
    """
    if sign is None or not responses.usable[0, 0].any():
        return None
    name = f"{names.outputs[0]}/{names.inputs[0]}"

    def margins(one: FrequencyResponses) -> tuple[LoopCurve, StabilityMargins]:
        target = target_of(one, (0, 0), name)
        target = target if sign == MINUS else turned(target)
        return loop_curve(target), stability_margins(target)

    curve, pooled = margins(responses)
    each: list[StabilityMargins | None] = []
    reasons: list[str] = []
    for number, part in enumerate(read.names):
        if len(read.signals) < 2:
            break
        chosen = slice(number, number + 1)
        alone = replace(
            read, signals=read.signals[chosen], names=(part,), durations=read.durations[chosen]
        )
        try:
            one = again(alone)
            each.append(margins(one)[1] if one.usable[0, 0].any() else None)
            reasons += [] if each[-1] else [f"{part}: no usable band by itself"]
        except FlightidError as error:
            each.append(None)
            reasons.append(f"{part}: no margins by itself: {error.what}")
    determined = [one for one in each if one is not None]
    worst = worst_margins(determined) if determined else ()
    at = [number for number, one in enumerate(each) if one is not None]
    worst = tuple(replace(one, maneuver=at[one.maneuver]) for one in worst)
    other = responses.joint and fitting_sign(_products(read)) not in (sign, None)
    cautions = _cautions(responses, names, sign, worst, contradicted=other)
    parts = read.names if each else ()
    return LoopMargins(
        name, sign, curve, pooled, parts, tuple(each), tuple(reasons), worst, cautions, other
    )


def _cautions(
    responses: FrequencyResponses,
    names: Names,
    sign: str,
    worst: Sequence[WorstMargin],
    *,
    contradicted: bool,
) -> tuple[str, ...]:
    out = []
    if not responses.joint:
        out.append(
            "margins from the direct estimate: what noise and turbulence bring back through the "
            "loop biases them; record the excitation and name it with --reference"
        )
    elif contradicted:
        out.append(sign_caution(names.references[0], names.inputs[0], names.outputs[0], sign))
    for one in worst:
        if one.p_value < DIFFERING_P_VALUE:
            out.append(
                f"{WORDS[one.name]}: the maneuvers differ by more than chance (p = "
                f"{one.p_value:.2g}); go by the worst one"
            )
    return tuple(out)


def _products(read: ReadSignals) -> np.ndarray:
    """Sums of products ``(3, 3)`` of reference, command and returned signal about their means."""
    rows = [np.concatenate([each.references, each.inputs, each.outputs]) for each in read.signals]
    centred = [row - row.mean(axis=1, keepdims=True) for row in rows]
    return np.asarray(sum(row @ row.T for row in centred))


def fitting_sign(products: np.ndarray) -> str | None:
    """Return the sign of the feedback according to the signals; None if undecided.

    A loop that subtracts has reference = command + returned, by which the two have regression
    coefficients of one sign.

    Parameters
    ----------
    products : ``(3, 3)``, of reference, command and returned signal about their means.
    """
    a, b = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=None)[0]
    return None if a * b == 0.0 else MINUS if a * b > 0.0 else PLUS


def sign_caution(reference: str, command: str, returned: str, sign: str) -> str:
    """Return a caution that the signals contradict the ``sign`` that was given."""
    other = PLUS if sign == MINUS else MINUS
    return (
        f"{reference} is closer to {command} {'+' if other == MINUS else '-'} {returned}: "
        f"--margins {other} fits these signals, and these margins are those of another loop"
    )


def loop_tables(loop: LoopMargins) -> list[Table]:
    """The margins of all records together, and of the worst maneuver where there are several."""
    sign = "-" if loop.sign == MINUS else "+"
    title = f"Stability margins of {loop.name}, a loop with command = excitation {sign} returned"
    named = loop.margins.named
    frequencies = [margin.frequency.value for margin in named.values()]
    margins = table(
        title,
        (Column("margin"), [WORDS[name] for name in named]),
        (Column("value", BY_ROW), [formatted(each.size.value, ".3g") for each in named.values()]),
        (Column("95 %", right=True), [interval_text(each) for each in named.values()]),
        (Column("at", "rad/s", printed="at rad/s"), [formatted(f, ".3g") for f in frequencies]),
        (
            Column("at", "Hz", printed="Hz"),
            [formatted(f / (2.0 * math.pi), ".3g") for f in frequencies],
        ),
        units=[UNITS[each.kind] for each in named.values()],
    )
    worst = table(
        "The worst maneuver, intervals for all together",
        (Column("worst of"), [WORDS[one.name] for one in loop.worst]),
        (Column("value", BY_ROW), [formatted(one.margin.size.value, ".3g") for one in loop.worst]),
        (Column("+-", BY_ROW, beside=True), [formatted(one.half, ".2g") for one in loop.worst]),
        (Column("maneuver"), [loop.parts[one.maneuver] for one in loop.worst]),
        (
            Column("maneuvers", PURE),
            [Number(sum(each is not None for each in one.values), digits=0) for one in loop.worst],
        ),
        (Column("p of no difference", PURE), [formatted(one.p_value, ".2g") for one in loop.worst]),
        units=[UNITS[one.margin.kind] for one in loop.worst],
    )
    return [each for each in (margins, worst) if each.rows]


def interval_text(margin: Margin) -> str:
    """``"4.5 to 4.8"``, and ``or wider`` where the usable band ends before the interval does."""
    text = f"{margin.low:.3g} to {margin.high:.3g}"
    return f"{text} or wider" if margin.open else text


def margin_lines(loop: LoopMargins) -> list[str]:
    """Return lines that compare the margins with the required ones."""
    out = []
    named = loop.margins.named
    sizes = [
        ("gain_increase", REQUIRED_GAIN, "dB"),
        ("gain_decrease", REQUIRED_GAIN, "dB"),
        ("phase_margin", REQUIRED_PHASE, "deg"),
    ]
    lines = []
    for name, required, unit in sizes:
        if name in named:
            ends = sorted(
                abs(end) if named[name].low * named[name].high > 0.0 else end
                for end in (named[name].low, named[name].high)
            )
            verdict = (
                "met"
                if ends[0] >= required and not named[name].open
                else "not met"
                if ends[1] < required
                else "undecided"
            )
            lines.append(f"{WORDS[name]} of {required:g} {unit} {verdict}")
    if loop.contradicted:
        out.append("not compared with MIL-F-9490D: the signals contradict the sign of the loop")
    elif lines:
        out.append(
            "MIL-F-9490D, below the first structural mode, with the 95 % intervals: "
            f"{', '.join(lines)}"
        )
    return [*out, *loop.margins.notes, *loop.reasons]


def margins_content(loop: LoopMargins) -> dict[str, object]:
    """Return the margins for ``responses.json``."""
    content: dict[str, object] = {
        "response": loop.name,
        "sign": loop.sign,
        "pooled": {name: _margin_content(each) for name, each in loop.margins.named.items()},
        "gain_crossings": [_margin_content(each) for each in loop.margins.phases],
        "phase_crossings": [_margin_content(each) for each in loop.margins.gains],
        "notes": [*loop.margins.notes, *loop.reasons],
    }
    if loop.parts:
        content["maneuvers"] = [
            {
                "name": part,
                **(
                    {name: _margin_content(one) for name, one in each.named.items()} if each else {}
                ),
            }
            for part, each in zip(loop.parts, loop.maneuvers, strict=True)
        ]
        content["worst"] = {
            one.name: {
                "value": one.margin.size.value,
                "half_width": one.half,
                "maneuver": loop.parts[one.maneuver],
                "p_alike": one.p_value,
            }
            for one in loop.worst
        }
    return content


def _margin_content(margin: Margin) -> dict[str, object]:
    return {
        "value": margin.size.value,
        "std": margin.size.std,
        "low": margin.low,
        "high": margin.high,
        **({"reaches_band_end": True} if margin.open else {}),
        "unit": UNITS[margin.kind],
        "frequency": margin.frequency.value,
    }
