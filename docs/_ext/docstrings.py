"""Docstrings of this project are plain text; Sphinx wants reStructuredText. What looks like markup
and is none is escaped.

Kept are names in backticks, indented blocks, and the parts that a line of dashes underlines
(Parameters, Returns, Raises, Attributes).
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import Any

CODE = re.compile(r"``(.+?)``|`([^`]+)`")
MARKS = re.compile(r"([\\*_|`<>])")
STARTS_LIKE_MARKUP = re.compile(r"[-+•] |\(?\w{1,3}[.)] |\.\.|:|>>>|[=\-~^#+.]{3,}|@")
# an entry begins a line or follows the last sentence of the one before
HEAD = re.compile(r"(?:^|(?<=[.;)`] ))[A-Za-z_*][\w.*]*(?:, [A-Za-z_*][\w.*]*)* : ")
ENTRY = re.compile(r"([\w.*]+(?:, [\w.*]+)*) : (.*)")
UNDERLINE = re.compile(r"-{3,}")


def escaped(text: str) -> str:
    """One paragraph in one line: code stays code, everything else is taken as it stands."""
    out, at = [], 0
    for found in CODE.finditer(text):
        out += [
            MARKS.sub(r"\\\1", text[at : found.start()]),
            f"\\ ``{(found[1] or found[2]).strip()}``\\ ",
        ]
        at = found.end()
    joined = "".join([*out, MARKS.sub(r"\\\1", text[at:])])
    joined = re.sub(r"::$", ":", joined)
    return f"\\ {joined}" if STARTS_LIKE_MARKUP.match(text) else joined


def entries(lines: Sequence[str]) -> Iterator[str]:
    """Lines of a part such as Parameters: each ``name : text`` as an item of a list, also where
    several stand in one line; anything else as a paragraph.
    """
    whole = " ".join(line.strip() for line in lines)
    starts = [found.start() for found in HEAD.finditer(whole)]
    for begin, end in pairwise(dict.fromkeys([0, *starts, len(whole)])):
        each = whole[begin:end].strip()
        head = ENTRY.fullmatch(each)
        yield f"* ``{head[1]}``: {escaped(head[2])}" if head else escaped(each)
        yield ""


def paragraphs(lines: Sequence[str]) -> Iterator[list[str]]:
    """Runs of lines without an empty one between them."""
    for filled, group in groupby(lines, key=lambda line: bool(line.strip())):
        if filled:
            yield list(group)


def plain(lines: Sequence[str]) -> list[str]:
    """A docstring's lines, dedented, as reStructuredText that reads the same."""
    out: list[str] = []
    listed = False
    for paragraph in paragraphs(lines):
        if len(paragraph) > 1 and UNDERLINE.fullmatch(paragraph[1].strip()):
            out += [f"**{paragraph[0].strip()}**", ""]
            listed, paragraph = True, paragraph[2:]
        if paragraph and paragraph[0].startswith(">>> "):
            out += [*paragraph, ""]
        elif paragraph and all(line.startswith("  ") for line in paragraph):
            out += ["::", "", *(f"    {line}" for line in paragraph), ""]
        elif listed and any(ENTRY.fullmatch(line) for line in paragraph):
            out += entries(paragraph)
        elif paragraph and paragraph[0].startswith("- "):
            out += [
                f"* {escaped(line.strip().removeprefix('- '))}" for line in joined_items(paragraph)
            ] + [""]
        elif paragraph:
            out += [escaped(" ".join(line.strip() for line in paragraph)), ""]
    return out


def joined_items(lines: Sequence[str]) -> list[str]:
    """Items of a list with hyphens, each in one line."""
    found: list[str] = []
    for line in lines:
        if line.startswith("- ") or not found:
            found.append(line.strip())
        else:
            found[-1] += " " + line.strip()
    return found


def process(
    app: Any, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Sphinx's hook: the lines are changed where they stand. Docstrings of other packages are left
    alone.
    """
    lines[:] = plain(lines)


def signature(
    app: object, what: str, name: str, thing: Any, options: object, given: str, returned: str
) -> tuple[str, str] | None:
    """Sphinx's hook: a command's arguments by name alone, since their annotations hold objects of
    the command line that print as addresses in memory.
    """
    if "typer.models" not in (given or ""):
        return None
    return f"({', '.join(inspect.signature(thing).parameters)})", returned


def setup(app: Any) -> dict[str, object]:
    """Sphinx's hook of an extension."""
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", signature)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
