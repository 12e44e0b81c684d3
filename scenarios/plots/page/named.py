"""A figure of a page as text; nothing here loads the plotting library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Drawn:
    """A figure of a page: the ``stem`` of its files, the SVG element, and a caption."""

    stem: str
    svg: str
    caption: str


FRAGMENT = ".page"  # ending of the file in which a figure of a page is left for it


def gathered(folder: Path) -> dict[str, str]:
    """The SVG elements by stem that were left in a folder; their files are gone afterwards."""
    found = {}
    for path in sorted(folder.glob(f"*{FRAGMENT}")):
        found[path.stem] = path.read_text(encoding="utf-8")
        path.unlink()
    return found
