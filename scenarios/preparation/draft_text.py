"""A draft of a channel map as text: a line a channel, what was left out, and what to write."""

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
        if guess.command and not guess.fault:
            entry = f'{{column = {quoted(f"THROW * {choice.column}")}, unit = "deg"}}'
        left_out = "left out: " if guess.fault else ""
        commented = "# " if guess.fault or guess.command else ""
        lines.append(
            f"{commented}{guess.channel} = {entry}  # {left_out}{guess.fault or guess.reason}"
        )
    missing = missing_channels(draft)
    if missing and draft.model in ("rigid", "lateral", "longitudinal"):
        lines.append(f"# Not found, and not needed by --model {draft.model}: {', '.join(missing)}.")
    elif missing:
        lines += [f"# Not found: {', '.join(missing)}. A line is such as", *_examples(draft)]
    unused = draft.unused and len(draft.topics) == 1  # a log has hundreds
    for words in (constant_words(draft), unused_words(draft) if unused else ""):
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


def _examples(draft: Draft) -> list[str]:
    """Lines for channels that were not found, as remarks, with columns that the file has."""
    missing = missing_channels(draft)
    pulses = [name for name in draft.unused if SERVO_PULSES.fullmatch(name)]
    if draft.model == "multirotor":
        return [f'# {missing[0]} = {{column = "(RCOU.C1 - 1500) / 500"}}']
    surfaces = [name for name in missing if name in SURFACES]
    if pulses and surfaces:
        moving = [name for name in pulses if name in draft.moving] or pulses
        of = {"aileron": 0, "elevator": 1, "rudder": 3}  # order of servo outputs from the factory
        return [
            f'# {name} = "pwm({pulses[of.get(name, 0) % len(pulses)]}, 1500, 573)"'
            for name in surfaces
        ] + [
            "# pwm(column, pulse at zero, us per radian): 573 where 10 us move the surface by 1 "
            "deg. Pulses that move: " + ", ".join(moving) + ".",
            "# SERVOn_FUNCTION in the log's parameters says which surface a channel moves; for "
            "elevons take",
            f'# elevator = "0.5*(pwm({moving[0]}, 1500, 573) + pwm({moving[-1]}, 1500, 573))"',
        ]
    sign, place = ("-", missing[0]) if draft.nearest == "lateral" else ("+", "elevator")
    return [f'# {place} = {{column = "0.5*(elevon_left {sign} elevon_right)", unit = "deg"}}']


def unused_words(draft: Draft) -> str:
    """The columns of a table for which no channel is proposed."""
    return f"Columns without a channel: {', '.join(draft.unused)}"


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


def quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
