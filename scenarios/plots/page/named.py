"""A figure of a page as text; nothing here loads the plotting library."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Drawn:
    """A figure of a page: the ``stem`` of its files, the SVG element, and a caption."""

    stem: str
    svg: str
    caption: str
