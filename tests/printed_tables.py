"""A printed table read back: what stands under each heading, whatever was folded and however many
blocks it took.
"""

from __future__ import annotations

import re
from collections.abc import Sequence


def read_back(lines: Sequence[str]) -> dict[str, list[str]]:
    """Heading -> cells of a table without a title, folded cells with their blanks closed up.

    The rule under the headings says which characters of a line are whose; a line whose columns at
    the right are all empty goes on with the row above it.
    """
    found: dict[str, list[str]] = {}
    for block in "\n".join(lines).split("\n\n"):
        rows = block.split("\n")
        at = next(i for i, row in enumerate(rows) if re.fullmatch(r" *-[- ]*", row))
        spans = [(each.start(), each.end()) for each in re.finditer("-+", rows[at])]
        heads = [closed([row[a:b] for row in rows[:at]]) for a, b in spans]
        for row in rows[at + 1 :]:
            outside = [row[b : b + 2] for _, b in spans[:-1]] + [row[spans[-1][1] :]]
            assert not "".join(outside).strip(), f"{row!r} runs over its columns"
        starts = [i for i, row in enumerate(rows) if i > at and not row.startswith(" " * 3)]
        for (a, b), head in zip(spans, heads, strict=True):
            cells = [
                closed([row[a:b] for row in rows[i:j]])
                for i, j in zip(starts, [*starts[1:], len(rows)], strict=True)
            ]
            assert found.setdefault(head, cells) == cells, f"{head} differs between blocks"
    return found


def closed(parts: Sequence[str]) -> str:
    """The parts of a text without any blanks, as it does not matter where they were folded."""
    return "".join("".join(parts).split())
