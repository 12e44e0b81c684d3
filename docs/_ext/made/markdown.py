"""Pieces of Markdown that the made pages share."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def cell(text: object) -> str:
    """Text as it may stand in a table: one line, no bars, no markup by accident."""
    return re.sub(r"([\\|*_<>$\[\]])", r"\\\1", " ".join(str(text).split()))


def code(text: object) -> str:
    """A name as code; nothing for nothing."""
    return f"`{text}`" if str(text) else ""


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already; columns without any entry are left out."""
    body = [list(row) for row in rows]
    kept = [i for i in range(len(heads)) if any(row[i] for row in body)]
    lines = [
        [heads[i] for i in kept],
        ["---"] * len(kept),
        *([row[i] for i in kept] for row in body),
    ]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def paragraph(text: str) -> str:
    """Plain text as one paragraph, without markup by accident; names in backticks stay."""
    parts = re.split(r"(``.+?``|`[^`]+`)", " ".join(text.split()))
    return "".join(
        f"`{part.strip('`')}`"
        if part.startswith("`")
        else re.sub(r"([\\*_<>$\[\]])", r"\\\1", part)
        for part in parts
    )


def fenced(kind: str, text: str) -> str:
    """A block of code."""
    return f"```{kind}\n{text.rstrip()}\n```\n"


def plain_block(text: str) -> str:
    """A docstring or other plain text with its own lines: paragraphs as such, indented ones and equations as they stand."""  # noqa: E501
    out = []
    for each in re.split(r"\n\s*\n", text.strip()):
        equations = all(line.startswith("  ") for line in each.splitlines())
        out.append(fenced("text", each) if equations else paragraph(each) + "\n")
    return "\n".join(out)
