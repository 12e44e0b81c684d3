"""The raw look in words and for the JSON files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ident.recording.series import RecordFinding
from scenarios.pages.model import Column, Table
from scenarios.preparation.recording import RawLook, Seen

SHOWN = 3  # places of one finding that a table has room for


def record_content(look: RawLook) -> dict[str, Any]:
    """The entry ``record`` of a study: which records were looked at, what was seen, how many samples of which channel were set aside."""
    masked: dict[str, dict[str, int]] = {}
    for one in look.seen:
        if one.masked:
            channels = masked.setdefault(one.record, {})
            channels[one.finding.channel] = channels.get(one.finding.channel, 0) + one.masked
    return {
        "looked_at": list(look.records),
        "trusted": look.trusted,
        "findings": [_content(one) for one in look.seen],
        "masked": masked,
    }


def record_lines(look: RawLook) -> list[str]:
    """What a terminal shows beside the warnings: what was set aside and what is worth knowing."""
    return [f"record: {line}" for line in look.lines]


def record_rows(look: RawLook) -> list[tuple[str, str, str, str, str]]:
    """Record, channel, what is seen, when, what was done: the rows of a page's table."""
    return [
        (one.record, one.finding.channel, one.finding.sentence, _when(one.finding), f"{one.masked} samples {one.done}" if one.masked else one.done)
        for one in look.seen
    ]


def record_table(look: RawLook) -> Table:
    """The same as a page's table; without rows where nothing is seen."""
    columns = tuple(map(Column, ("record", "channel", "seen", "when", "done")))
    caption = "What the raw columns show, before any fit; samples that were set aside count in no fit and no error"
    return Table(caption, columns, tuple(record_rows(look)))


def _content(one: Seen) -> dict[str, Any]:
    finding = one.finding
    return {
        "record": one.record,
        "channel": finding.channel,
        "kind": finding.kind.value,
        "certainty": finding.certainty.value,
        "times": [[begin, end] for begin, end in finding.times],
        "numbers": {name: {"value": number.value, "unit": number.unit} for name, number in finding.numbers.items() if math.isfinite(number.value)},
        "masked": one.masked,
        "done": one.done,
        "sentence": f"{finding.channel} {finding.sentence}",
        **({"remedy": finding.remedy} if finding.remedy else {}),
    }


def _when(finding: RecordFinding) -> str:
    if not finding.times:
        return "throughout"
    return ", ".join(_span(finding.times[:SHOWN])) + (f" and {len(finding.times) - SHOWN} more" if len(finding.times) > SHOWN else "")


def _span(times: Sequence[tuple[float, float]]) -> list[str]:
    return [f"{begin:.4g} s" if begin == end else f"{begin:.4g} to {end:.4g} s" for begin, end in times]
