"""The folder of a search: ``maneuvers.toml`` for the commands that use it, the figure, the page, and the JSON last."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json, write_text
from scenarios.maneuvers.finding import Maneuvers, NumberedManeuver
from scenarios.maneuvers.page import maneuvers_page
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.preparation.maneuver_file import FILE

MAIN = "maneuvers.json"
SCHEMA = "flightid/maneuvers/1"
_HEAD = """\
# Maneuvers of one record, for --maneuver NUMBER or NAME of identify, diagnose and survey. Edit it freely: names and times, further
# tables, tables deleted. Times are in s and include rest before the input and the response after it.
"""


def write_maneuvers(found: Maneuvers, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a search into ``folder``, whole or not at all; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from functools import partial

            from scenarios.plots.maneuvers import figure_flight
            from scenarios.plots.page.drawing import drawn_for_page

            drawn = drawn_for_page([("flight", partial(figure_flight, found, found.identity.name))], scratch, figures)
        write_text(scratch / FILE, maneuvers_toml(found))
        write_page(scratch, maneuvers_page(found, drawn))
        write_json(scratch / MAIN, maneuvers_content(found))
    return Path(folder)


def maneuvers_toml(found: Maneuvers) -> str:
    """Content of ``maneuvers.toml``."""
    lines = [
        _HEAD,
        f"record = {_text(found.identity.name)}",
        f"sha256 = {_text(found.identity.sha256)}",
    ]
    for each in found.maneuvers:
        lines += [
            "",
            "[[maneuvers]]",
            f"number = {each.number}",
            f"name = {_text(each.name)}",
            f"from = {each.start!r}",
            f"to = {each.stop!r}",
            f"axis = {_text(each.found.axis)}",
            f"kind = {_text(each.found.kind)}",
        ]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    """A text as TOML writes it; JSON's escapes are among TOML's, but for the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def maneuvers_content(found: Maneuvers) -> dict[str, Any]:
    """Content of ``maneuvers.json``: SI, nz in g."""
    return {
        "schema": SCHEMA,
        "maneuvers": [_content(each) for each in found.maneuvers],
        "active_share": found.active,
        "warnings": list(found.cautions),
        "inputs": {"records": [found.identity.name], "sha256": [found.identity.sha256]},
        "versions": versions(),
    }


def _content(each: NumberedManeuver) -> dict[str, Any]:
    one = each.found
    moved = {"channel": one.channel, "amplitude": one.amplitude, "unit": each.unit} if one.channel else {}
    return {
        "number": each.number,
        "name": each.name,
        "start": one.start,
        "end": one.end,
        "from": each.start,
        "to": each.stop,
        "axis": one.axis,
        "kind": one.kind,
        **moved,
        **dict(one.conditions),
        "excitation": dict(one.excitation),
    }
