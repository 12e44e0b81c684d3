"""What a notebook shows of a result: a heading, sentences, a table; plain HTML without a style of its own."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape


def page(heading: str, *parts: str) -> str:
    """A heading in bold, then the parts that are not empty."""
    return "\n".join(["<div>", f"<p><strong>{escape(heading)}</strong></p>", *(part for part in parts if part), "</div>"])


def sentences(lines: Sequence[str]) -> str:
    """A list of sentences; nothing where there is none."""
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>" if lines else ""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """A table whose first ``left`` columns stand at the left and the others at the right; nothing where there is no row."""
    if not rows:
        return ""
    sides = ["left" if i < left else "right" for i in range(len(headings))]

    def line(cells: Sequence[str], tag: str) -> str:
        told = (f'<{tag} style="text-align:{side};padding:0 0.6em">{escape(cell)}</{tag}>' for cell, side in zip(cells, sides, strict=True))
        return f"<tr>{''.join(told)}</tr>"

    return f"<table><thead>{line(headings, 'th')}</thead><tbody>{''.join(line(row, 'td') for row in rows)}</tbody></table>"
