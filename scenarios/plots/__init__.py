"""Figures: pure functions that take results and return matplotlib Figures; the only modules that
import matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.report.figure_formats import Drawn, Formats


def draw_into(
    folder: Path,
    named: Iterable[tuple[str, Callable[[], Figure]]],
    formats: Formats,
    methods: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Drawn, ...]:
    """Draw the figures of a study into its folder and return them for its page; empty without a
    format.

    Parameters
    ----------
    folder : one that exists.
    named : the stem of each file, and what draws it.
    formats : of the files.
    methods : label of each method whose name ends a stem.
    """
    if not formats:
        return ()
    from scenarios.plots.drawing import draw_for_page

    return draw_for_page(named, folder, formats, methods)
