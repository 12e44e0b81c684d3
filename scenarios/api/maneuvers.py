"""`maneuvers` in Python: the maneuvers in a long record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api import plot
from scenarios.api.asking import Source, file_of, plan_from
from scenarios.api.records.opening import Choices, choices_of
from scenarios.api.running import KEPT
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.files.channels import read_channel_map
from scenarios.maneuvers import finding
from scenarios.plots.formats import formats_wanted
from scenarios.preparation.maneuver_file import Parts

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Maneuvers:
    """The maneuvers of a record. ``details``: everything that the library knows of them."""

    details: finding.Maneuvers

    @property
    def parts(self) -> Parts:
        """The parts of the record to use, which ``identify`` and ``diagnose`` take as ``maneuvers``."""
        return self.details.parts

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know, one sentence each."""
        return self.details.cautions

    def __len__(self) -> int:
        return len(self.details.maneuvers)

    def summary(self) -> str:
        """What the command prints."""
        from scenarios.maneuvers.text import print_maneuvers
        from scenarios.terminal.numbers import as_text

        return as_text(lambda out: print_maneuvers(self.details, out, KEPT))

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a maneuver by its number: times of the input, the part to use, axis, kind, channel, amplitude (SI), t values."""
        import pandas

        rows = self.to_dict()["maneuvers"]
        flat = [
            {key: value for key, value in row.items() if key != "excitation"} | {f"t_{name}": value for name, value in row["excitation"].items()}
            for row in rows
        ]
        columns = ["number", "name", "start", "end", "from", "to", "axis", "kind"]
        frame = pandas.DataFrame(flat) if flat else pandas.DataFrame(columns=columns)
        return frame.set_index("number")

    def to_dict(self) -> dict[str, Any]:
        """Content of ``maneuvers.json``."""
        from scenarios.maneuvers.files import maneuvers_content

        return maneuvers_content(self.details)

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path:
        """Write ``maneuvers.toml``, figure and page as the command does with ``--out``; returns the folder."""
        from scenarios.maneuvers.files import write_maneuvers

        return write_maneuvers(self.details, Path(folder), figures=formats_wanted(figures))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figure; returns the path."""
        return write_report(self.save, path)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.maneuvers()``."""
        return plot.Figures(self, plot.maneuvers)

    def __repr__(self) -> str:
        return f"<Maneuvers of {self.details.identity.name:.200}: {len(self)}>"

    def _repr_html_(self) -> str:
        rows = [[str(m.number), m.name, f"{m.found.start:.2f}", f"{m.found.end:.2f}"] for m in self.details.maneuvers]
        title = f"maneuvers of {self.details.identity.name}"
        return html.page(
            title,
            html.table(("no.", "maneuver", "start, s", "end, s"), rows, left=2),
            html.sentences(self.warnings),
        )


def find_maneuvers(
    record: Source, *, channels: Choices | None = None, columns: str | Sequence[str] | None = None, rate: float | None = None
) -> Maneuvers:
    """Find the maneuvers in a record of any length: ``flightid maneuvers`` in Python.

    Parameters
    ----------
    record : a ``Record``, or whatever ``read_record`` takes.
    channels : a channel map as in ``read_record``. columns : names of the columns of a file without
        a header, in their order.
    rate : Hz, of a file without a clock, or of the grid of a log's topics.

    Raises
    ------
    InputError : anything in the record that keeps it from being searched, in one line.
    """
    chosen = choices_of(channels)
    plan = plan_from(None, None, None, rate, None, False, columns)
    return Maneuvers(finding.maneuvers_of(file_of(record), read_channel_map(chosen) if chosen is not None else None, plan))
