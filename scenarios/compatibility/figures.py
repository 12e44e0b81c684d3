"""Which figures a check gets: one for each record whose motion was integrated."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from ident.compatibility.trials import Compatibility
from scenarios.plots.compatibility import figure_reconstruction
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.plots.files import Named


def check_figures(result: Compatibility, simulated: bool) -> Iterator[Named]:
    """The figures of a check: the stem of each file, and what draws it."""
    data = SIMULATED_DATA if simulated else MEASURED_DATA
    for number, item in enumerate(result.reconstructions, start=1):
        stem = "reconstruction" if number == 1 else f"reconstruction_{number}"
        yield stem, partial(figure_reconstruction, item, f"{item.record}: {data} and reconstruction", data)
