"""The gallery: a picture of each scenario and the signature of each effect."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from docs._ext.made.effects import by_family, first_sentence

PICTURES = Path(__file__).parents[2] / "gallery"


def gallery_page() -> str:
    """Cards of scenarios and effects, each with its picture and a link to what says more."""
    from scenarios.studies.catalogue import KINDS, scenario_names, scenario_title
    from sim.effects.library import library

    parts = [
        "# Gallery\n",
        "The flights that `flightid run` simulates, and the signature of each effect that "
        "`flightid diagnose` looks for.\n",
        "## Effects\n",
        "An output in a 3-2-1-1 without the effect (grey) and with it at its usual values (blue); "
        "below, the difference (green). Effects of a falling body are shown on its fall, "
        "turbulence and a missing term on a simulated flight.\n",
        *_cards(
            (name, f"effects.md#{name.lower()}", first_sentence(some[0].explanation), "effect")
            for name, some in by_family(library()).items()
        ),
        "## Scenarios\n",
        "The first input (green) and the first output (blue) of each simulated flight.\n",
        *_cards(
            (name, f"scenario/{name}.md", scenario_title(name), "scenario")
            for kind in KINDS
            for name in scenario_names(kind)
        ),
    ]
    return "\n".join(parts)


def _cards(some: Iterator[tuple[str, str, str, str]]) -> list[str]:
    """A table of three columns, a card a cell: picture, name with its link, one sentence; what has
    no picture has the words alone.
    """
    cells = []
    for name, target, told, kind in some:
        picture = PICTURES / f"{kind}-{name}.svg"
        shown = f"![{name}](../gallery/{picture.name})<br>" if picture.is_file() else ""
        sentence = told.replace("|", "\\|").replace("\n", " ")
        cells.append(f"{shown}[`{name}`]({target})<br>{sentence}")
    rows = [cells[i : i + 3] for i in range(0, len(cells), 3)]
    lines = [f"| {' | '.join([*row, *([''] * (3 - len(row)))])} |" for row in rows]
    return ["| | | |", "|---|---|---|", *lines, ""]
