"""`survey` in Python: many flights of one aircraft, and what recurs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

from scenarios.api.running import KEPT, Progress, untold
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.plots.formats import formats_wanted
from scenarios.survey import survey as surveying
from scenarios.survey.report.files import write_survey
from scenarios.survey.report.text import survey_text
from scenarios.survey.report.words import derivative_rows, drifts, effect_rows, outstanding, verdict_of
from scenarios.tasks.sharing import available_cores

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Survey:
    """What many flights of one aircraft show together. ``details``: everything that the library knows of it. ``folder``: where flights are kept."""

    details: surveying.Survey
    folder: Path

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that recur, the strongest first."""
        return tuple(each.name for each in self.details.recurs)

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the flights that could be used, in the order of the file."""
        return tuple(self.details.grown.kept)

    @property
    def computed(self) -> tuple[str, ...]:
        """Of these, the flights that were diagnosed in this call; the others were kept."""
        return self.details.grown.computed

    @property
    def failed(self) -> dict[str, str]:
        """Flights that could not be used, with the reason."""
        return dict(self.details.grown.failed)

    @property
    def trends(self) -> tuple[str, ...]:
        """Derivatives that change with a flight condition, one sentence each."""
        return tuple(drifts(self.details))

    @property
    def standing_out(self) -> tuple[tuple[str, str, float], ...]:
        """Flights that stand out: flight, derivative, by how many standard deviations."""
        return tuple(outstanding(self.details))

    def to_dataframe(self) -> pandas.DataFrame:
        """Derivatives, one row a flight: value (``Cm_alpha``) and sigma (``Cm_alpha_std``) of each in SI, and the flight's conditions."""
        import pandas

        rows: dict[str, dict[str, float]] = {name: {} for name in self.flights}
        for name, by_flight in self.details.conditions.items():
            for flight, value in by_flight.items():
                rows[flight][name] = value
        for each in self.details.derivatives:
            for flight, value, sigma in zip(each.flights, each.values, each.sigmas, strict=True):
                rows[flight] |= {each.name: float(value), f"{each.name}_std": float(sigma)}
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("flight")

    def recurring(self) -> pandas.DataFrame:
        """Effects, one row a flight: the probability that it has each."""
        import pandas

        return pandas.DataFrame({e.name: dict(zip(e.flights, e.found.probability, strict=True)) for e in self.details.recurs}).rename_axis("flight")

    def to_dict(self) -> dict[str, Any]:
        """Content of ``survey.json``."""
        from scenarios.pages.reproduction import now
        from scenarios.survey.report.content import survey_content

        return survey_content(self.details, now())

    def summary(self) -> str:
        """What the command prints."""
        return survey_text(self.details, details=KEPT)

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path:
        """Write the survey's own files as the command does with ``--out``; the flights' folders stay in ``folder`` of the result."""
        return write_survey(self.details, Path(folder), figures=formats_wanted(figures))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    def __repr__(self) -> str:
        return repr(self.details)

    def _repr_html_(self) -> str:
        word, rest = verdict_of(self.details)
        return html.page(f"{word}: {rest}", html.table(*effect_rows(self.details), left=3), html.table(*derivative_rows(self.details), left=2))


def survey(
    flights: str | PathLike[str],
    folder: str | PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    figures: bool | str | Sequence[str] = False,
    progress: Progress | None = None,
    cluster: str | None = None,
) -> Survey:
    """Many flights of one aircraft, each diagnosed, then what recurs: ``flightid survey`` in Python.

    Parameters
    ----------
    flights : the file that names model, vehicle and records. folder : where each flight's results are kept, so that the next survey computes
        only what is new; None takes a new one for temporary files. jobs : processes, all cores when left out.
    figures : of the flights' own pages. progress : told the stage and the share done, 0 to 1.
    cluster : the address of a Dask scheduler, whose workers take the place of processes.

    Raises
    ------
    InputError : anything wrong in the file, in one line. A flight that cannot be used is told in ``failed``.
    """
    kept = Path(folder) if folder is not None else Path(mkdtemp(prefix="flightid-survey-"))
    found = surveying.survey_flights(Path(flights), kept, jobs or available_cores(), formats_wanted(figures), progress or untold, cluster)
    return Survey(found, kept)
