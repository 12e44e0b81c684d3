"""The draft of a channel map as TOML: a line for each channel, and comments on missing channels and
unused columns.
"""

from __future__ import annotations

import json
import textwrap

import numpy as np

from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import RecordFile
from scenarios.preparation.drafting import (
    COMMANDS,
    SERVO_PULSES,
    SURFACES,
    Draft,
    topics_of,
)

COMMENT_WIDTH = 100  # characters of a comment line
SERVO_ORDER = {"aileron": 0, "elevator": 1, "rudder": 3}  # usual number of a surface's servo output
# Nearest model -> channels that a draft reports as missing.
WANTED = {
    "multirotor": (*COMMANDS, "p", "q", "r", "az"),
    "lateral": ("aileron", "rudder", "beta", "p", "r", "phi"),
    "": ("elevator", "aileron", "rudder", "alpha", "beta", "q"),
}


def map_text(draft: Draft) -> str:
    """Return the draft as a channel map in TOML, with the reason for each line."""
    lines = [
        f"# Draft of a channel map for {draft.file.path.name}. Check every line: names do not say "
        "signs, and seldom units."
    ]
    for guess in draft.guesses:
        choice = guess.choice
        column = choice.column if isinstance(choice.column, int) else quoted(choice.column)
        entry = str(column)
        if guess.command and not guess.fault:
            entry = f'{{column = {quoted(f"THROW * {choice.column}")}, unit = "deg"}}'
        elif choice.unit is not None:
            entry = f"{{column = {column}, unit = {quoted(choice.unit)}}}"
        reason = f"left out: {guess.fault}" if guess.fault else guess.reason
        comment_mark = "# " if guess.fault or guess.command else ""
        lines.append(f"{comment_mark}{guess.channel} = {entry}  # {reason}")
    missing = missing_channels(draft)
    if missing and draft.model in ("rigid", "lateral", "longitudinal"):
        lines.append(f"# Not found, and not needed by --model {draft.model}: {', '.join(missing)}.")
    elif missing:
        lines += [f"# Not found: {', '.join(missing)}. A line is such as", *_examples(draft)]
    sentences = [constant_words(draft)]
    if draft.unused and len(draft.topics) == 1:  # a log of several topics has hundreds of columns
        sentences.append(unused_words(draft))
    for sentence in sentences:
        lines += textwrap.wrap(
            f"{sentence}." if sentence else "",
            COMMENT_WIDTH,
            initial_indent="# ",
            subsequent_indent="# ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    lines += _sweep_comments(draft.file)
    return "\n".join(lines) + "\n"


def missing_channels(draft: Draft) -> list[str]:
    """Return the channels of the nearest model for which no column is proposed."""
    present = {guess.channel for guess in draft.guesses} | {*draft.constant}
    return [name for name in WANTED.get(draft.nearest, WANTED[""]) if name not in present]


def constant_words(draft: Draft) -> str:
    """Return a sentence on the columns that are left out because they never move; empty without
    any.
    """
    columns = ", ".join(draft.constant.values())
    return f"Left out, since they never move: {columns}" if columns else ""


def _examples(draft: Draft) -> list[str]:
    """Return comments with examples of lines for missing channels, from columns of the file."""
    missing = missing_channels(draft)
    pulses = [name for name in draft.unused if SERVO_PULSES.fullmatch(name)]
    if draft.model == "multirotor":
        return [f'# {missing[0]} = {{column = "(RCOU.C1 - 1500) / 500"}}']
    surfaces = [name for name in missing if name in SURFACES]
    if pulses and surfaces:
        moving = [name for name in pulses if name in draft.moving] or pulses
        servos = {name: pulses[SERVO_ORDER.get(name, 0) % len(pulses)] for name in surfaces}
        return [f'# {name} = "pwm({servo}, 1500, 573)"' for name, servo in servos.items()] + [
            "# pwm(column, pulse at zero, us per radian): 573 where 10 us move the surface by 1 "
            "deg. Pulses that move: " + ", ".join(moving) + ".",
            "# SERVOn_FUNCTION in the log's parameters says which surface a channel moves; for "
            "elevons take",
            f'# elevator = "0.5*(pwm({moving[0]}, 1500, 573) + pwm({moving[-1]}, 1500, 573))"',
        ]
    sign, channel = ("-", missing[0]) if draft.nearest == "lateral" else ("+", "elevator")
    return [f'# {channel} = {{column = "0.5*(elevon_left {sign} elevon_right)", unit = "deg"}}']


def unused_words(draft: Draft) -> str:
    """Return a sentence on the columns of a table for which no channel is proposed."""
    return f"Columns without a channel: {', '.join(draft.unused)}"


def _sweep_comments(file: RecordFile) -> list[str]:
    """Return comments with the command for a sweep of ArduPilot's SYSID mode; else an empty list.

    The output is the angular rate that moves most.
    """
    for topic in topics_of(file):
        columns = {name: i for i, name in enumerate(topic.table.header)}
        rates = [name for name in ("Gx", "Gy", "Gz") if name in columns]
        if topic.name != "SIDD" or "Targ" not in columns or not rates:
            continue
        ranges = {name: np.ptp(numbers(topic.table, columns[name]).values) for name in rates}
        rate = max(ranges, key=lambda name: ranges[name])
        path = file.path.name
        return [
            "# A sweep of ArduPilot's SYSID mode. Its frequency response:",
            f"# flightid response {path} --input SIDD.Targ --output SIDD.{rate} --out bode",
        ]
    return []


def quoted(text: str) -> str:
    """Return a text as a TOML string."""
    return json.dumps(text, ensure_ascii=False)
