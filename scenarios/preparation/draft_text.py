"""The text of a draft of a channel map: what is proposed, what is missing, what has no channel."""

from __future__ import annotations

import json
import textwrap

import numpy as np

from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import RecordFile
from scenarios.preparation.drafting import COMMANDS, MOST_UNUSED, Draft, topics_of_file

COMMENT_WIDTH = 100  # characters of a line of a draft
# channels that a draft calls missing, by the model that is nearest
WANTED = {
    "multirotor": (*COMMANDS, "p", "q", "r", "az"),
    "lateral": ("aileron", "rudder", "beta", "p", "r", "phi"),
    "": ("elevator", "aileron", "rudder", "alpha", "beta", "q"),
}


def map_text(draft: Draft) -> str:
    """Return the draft as a channel map in TOML, with a reason beside each line."""
    lines = [
        f"# Draft of a channel map for {draft.file.path.name}. Check every line: names do not say "
        "signs, and seldom units."
    ]
    for guess in draft.guesses:
        choice = guess.choice
        column = choice.column if isinstance(choice.column, int) else quoted(choice.column)
        entry = (
            str(column)
            if choice.unit is None
            else f"{{column = {column}, unit = {quoted(choice.unit)}}}"
        )
        lines.append(
            f"# {guess.channel} = {entry}  # left out: {guess.fault}"
            if guess.fault
            else f"{guess.channel} = {entry}  # {guess.reason}"
        )
    missing = missing_channels(draft)
    if missing:
        lines.append(f"# Not found: {', '.join(missing)}. A line is such as")
        example = (
            "(RCOU.C1 - 1500) / 500"
            if draft.model == "multirotor"
            else f"0.5*(elevon_left {'-' if draft.nearest == 'lateral' else '+'} elevon_right)"
        )
        unit = "" if draft.model == "multirotor" else ', unit = "deg"'
        place = missing[0] if unit == "" or draft.nearest == "lateral" else "elevator"
        lines.append(f'# {place} = {{column = "{example}"{unit}}}')
    if draft.unused:
        lines += textwrap.wrap(
            f"{unused_words(draft)}.",
            COMMENT_WIDTH,
            initial_indent="# ",
            subsequent_indent="# ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    lines += _sweep_words(draft.file)
    return "\n".join(lines) + "\n"


def missing_channels(draft: Draft) -> list[str]:
    """Return the channels of the nearest model for which no column is proposed."""
    found = {guess.channel for guess in draft.guesses}
    return [name for name in WANTED.get(draft.nearest, WANTED[""]) if name not in found]


def unused_words(draft: Draft) -> str:
    """The columns for which no channel is proposed; of a log with many topics the first ones."""
    most = len(draft.unused) if len(draft.topics) == 1 else MOST_UNUSED
    more = len(draft.unused) - most
    tail = f" and {more} more" if more > 0 else ""
    return f"Columns without a channel: {', '.join(draft.unused[:most])}{tail}"


def _sweep_words(file: RecordFile) -> list[str]:
    """Options for the sweep of ArduPilot's SYSID mode: its target and the rate or acceleration that
    it moves most; empty for other files.
    """
    for topic in topics_of_file(file):
        known = {name: at for at, name in enumerate(topic.table.header)}
        rates = [name for name in ("Gx", "Gy", "Gz") if name in known]
        if topic.name != "SIDD" or "Targ" not in known or not rates:
            continue
        moved = {name: np.ptp(numbers(topic.table, known[name]).values) for name in rates}
        most = max(moved, key=lambda name: moved[name])
        path = file.path.name
        return [
            "# A sweep of ArduPilot's SYSID mode. Its frequency response:",
            f"# flightid response {path} --input SIDD.Targ --output SIDD.{most} --out bode",
        ]
    return []


def quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
