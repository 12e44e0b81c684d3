"""Times of the same work at growing sizes, as a table with the exponent of growth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.comparison.compare import Pace
from benchmarks.comparison.page import Table, seconds
from benchmarks.comparison.timing import interleaved, quartiles

LARGE = 3  # sizes at the large end, of which the exponent is told


@dataclass(frozen=True)
class Series:
    """Works at growing sizes.

    Attributes
    ----------
    name : for `--jobs`. title, about : for the page. unit : what a size counts.
    sizes : in order; those of a quick run are the first ``quick``.
    works : by what is done; each prepares the work of a size.
    rounds : of calls, at most.
    """

    name: str
    title: str
    about: str
    unit: str
    sizes: tuple[int, ...]
    works: Mapping[str, Callable[[int], Callable[[], Any]]]
    quick: int = 2
    rounds: int = 7


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Slope of log time over log size at the ``LARGE`` end, least squares: 1 where time grows as
    the size.
    """
    return float(np.polyfit(np.log(sizes[-LARGE:]), np.log(times[-LARGE:]), 1)[0])


def grown(series: Series, pace: Pace, say: Callable[[str], None]) -> Table:
    """Measure a series, sizes and works in turn."""
    sizes = series.sizes[: series.quick] if pace.small else series.sizes
    say(f"{series.name}: {len(sizes)} sizes of {len(series.works)} works")
    prepared = {
        f"{what} {size}": prepare(size) for size in sizes for what, prepare in series.works.items()
    }
    times = interleaved(prepared, min(series.rounds, pace.rounds), pace.patience / 2.0)
    found = {what: [quartiles(times[f"{what} {size}"]) for size in sizes] for what in series.works}
    slopes = {
        what: exponent(sizes, [each.median for each in values]) for what, values in found.items()
    }
    rows = [
        (str(size), *(seconds(found[what][i].median) for what in found))
        for i, size in enumerate(sizes)
    ]
    rows.append(("exponent", *(f"{slopes[what]:.2f}" for what in found)))
    data = {
        "sizes": list(sizes),
        "works": {
            what: {"seconds": [each._asdict() for each in values], "exponent": slopes[what]}
            for what, values in found.items()
        },
    }
    return Table(series.title, series.about, (series.unit, *found), tuple(rows), data)
