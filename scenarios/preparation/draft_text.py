"""The text of a drafted channel map, and the words on what it leaves out."""

from __future__ import annotations

import textwrap

import numpy as np

from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import RecordFile
from scenarios.preparation.drafting import COMMANDS, Draft, quoted, topics_of

COMMENT_WIDTH = 100  # characters of a line of a draft
MOST_UNUSED = 60  # columns of a log that are listed without a channel
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
        if guess.command and not guess.fault:
            entry = f'{{column = {quoted(f"THROW * {choice.column}")}, unit = "deg"}}'
        left_out = "left out: " if guess.fault else ""
        commented = "# " if guess.fault or guess.command else ""
        lines.append(
            f"{commented}{guess.channel} = {entry}  # {left_out}{guess.fault or guess.reason}"
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
    for words in (constant_words(draft), unused_words(draft) if draft.unused else ""):
        lines += textwrap.wrap(
            f"{words}." if words else "",
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
    found |= {*draft.constant}
    return [name for name in WANTED.get(draft.nearest, WANTED[""]) if name not in found]


def constant_words(draft: Draft) -> str:
    """The columns that are left out because they never move; empty without any."""
    columns = ", ".join(draft.constant.values())
    return f"Left out, since they never move: {columns}" if columns else ""


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
    for topic in topics_of(file):
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
