"""All tables of growth in the order of the page, by the names of `--jobs`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from benchmarks.comparison.compare import Pace
from benchmarks.comparison.page import Table
from benchmarks.scaling.growth import SERIES
from benchmarks.scaling.processes import jobs, memory
from benchmarks.scaling.series import Series, grown

Measure = Callable[[Pace, Path, Callable[[str], None]], Table]


def _series(series: Series, pace: Pace, folder: Path, say: Callable[[str], None]) -> Table:
    return grown(series, pace, say)


TABLES: Mapping[str, Measure] = {
    **{each.name: partial(_series, each) for each in SERIES},
    "jobs": jobs,
    "memory": memory,
}
