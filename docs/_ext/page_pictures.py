"""Figures of the pages of labs and of functions: ``python docs/_ext/page_pictures.py`` writes
``docs/gallery/lab-*.png`` and ``docs/gallery/python-*.png``.

A lab is run as it begins, and its figures are kept; a function is called as its example calls it.
"""

from __future__ import annotations

import argparse
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

from matplotlib.figure import Figure

from docs._ext.made.labs import notebooks

FOLDER = Path(__file__).parents[1] / "gallery"


def of_labs() -> Iterator[tuple[str, Figure]]:
    """``lab-NUMBER-FIGURE`` and the figure, which counts by its place in the notebook."""
    from docs._ext.made.labs import figures_of
    from flightid.labs import page

    drawn: dict[str, Figure] = {}

    def keep(figure: Figure, told: str) -> Any:
        drawn[told] = figure
        return shown(figure, told)

    shown = page.interactive_figure
    for number, path in notebooks().items():
        drawn.clear()
        with patch.object(page, "interactive_figure", keep):
            runpy.run_path(str(path))["app"].run()
        for at, told in enumerate(figures_of(path), 1):
            if told in drawn:
                yield f"lab-{number}-{at}", drawn[told]


def of_functions() -> Iterator[tuple[str, Figure]]:
    """``python-NAME`` and a figure of what the function returns."""
    import flightid as fid

    flight = fid.simulate("trace-delay", seed=1)
    record, vehicle, other = flight.record, flight.vehicle, flight.validate
    yield "python-simulate", fid.plot.record(record)
    yield "python-identify", fid.identify(record, "rigid", vehicle).plot.fit()
    yield "python-check", fid.check(record, vehicle).plot.reconstruction()
    found = fid.diagnose(record, "rigid", vehicle, validate=other)
    yield "python-diagnose", found.plot.prediction()
    yield "python-find_maneuvers", fid.plot.maneuvers(fid.find_maneuvers(record))
    yield "python-run", fid.run("rigid", seed=3).plot.fit()
    swept = fid.simulate("uav-sweep", seed=1).record
    yield (
        "python-frequency_response",
        fid.frequency_response(swept, "command", "p", reference="sweep").plot.response(),
    )


def main(words: list[str] | None = None) -> None:
    """Write the pictures, and take away those that are no longer made."""
    from scenarios.plots.drawing import figure_png

    kinds = {"lab": of_labs, "python": of_functions}
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("kinds", nargs="*", default=[], help=f"{' or '.join(kinds)}; else both")
    for kind in parser.parse_args(words).kinds or kinds:
        made = {stem: figure_png(figure) for stem, figure in kinds[kind]()}
        for old in FOLDER.glob(f"{kind}-*.png"):
            if old.stem not in made:
                old.unlink()
        for stem, content in made.items():
            (FOLDER / f"{stem}.png").write_bytes(content)
        print(f"{len(made)} pictures of {kind} in {FOLDER}")


if __name__ == "__main__":
    main()
