"""``design`` in Python: which maneuver to fly, before it is flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api import tables
from scenarios.api.keywords import told_in_python
from scenarios.api.record import Record, record_of
from scenarios.api.requests import (
    Declared,
    model_of,
)
from scenarios.api.shown import write_report
from scenarios.api.vehicle import Vehicle, source_of
from scenarios.maneuver_design import design as designing
from scenarios.maneuver_design.report import design_text, verdict_of
from scenarios.maneuver_design.setting import TYPICAL, DesignRequest
from scenarios.maneuver_design.tables import maneuvers_table, peaks_of
from scenarios.report.figure_formats import formats_wanted
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Design:
    """Maneuvers compared before they are flown, the best first. ``details``: everything that the
    library knows of it.
    """

    details: designing.DesignResult

    @property
    def best(self) -> str:
        """Kind of the best maneuver."""
        return self.details.best.kind

    @property
    def chance(self) -> float:
        """Probability, at least, that the best maneuver tells the effects apart; zero where none
        were named.
        """
        return self.details.best.chance

    @property
    def sigmas(self) -> Mapping[str, float]:
        """Expected standard deviations with the best maneuver, by parameter, SI."""
        return self.details.best.sigmas

    @property
    def command(self) -> str:
        """What is typed for the same design."""
        return self.details.asked.command()

    def maneuver(self, kind: str | None = None) -> Record:
        """The input to be flown, of the best kind or another: a record without outputs, SI, held
        between samples.
        """
        from scenarios.maneuver_design.report import input_of

        chosen = next(
            (each for each in self.details.maneuvers if each.kind == kind), self.details.best
        )
        return record_of(input_of(chosen))

    def coherence(self, output: str, input: str, kind: str | None = None) -> pandas.DataFrame:
        """Coherence and random error to expect of a response, by frequency in Hz; of the best kind
        or another.

        Raises InputError where no band was asked for, or there is no such response.
        """
        import pandas

        chosen = next(
            (each for each in self.details.maneuvers if each.kind == kind), self.details.best
        )
        found = chosen.responses
        if found is None:
            raise DeclarationError("no band is asked for", where="design", remedy="give band, Hz")
        for name, names in ((output, found.outputs), (input, found.inputs)):
            if name not in names:
                remedy = f"there are {', '.join(names)}"
                raise DeclarationError(f"there is no {name!r}", where="coherence", remedy=remedy)
        at = found.outputs.index(output), found.inputs.index(input)
        columns = {"coherence": found.coherence[at], "random_error": found.random_error[at]}
        return pandas.DataFrame(columns, index=pandas.Index(found.frequency, name="frequency_Hz"))

    def to_dataframe(self) -> pandas.DataFrame:
        """A row a kind, the best first: pace (s), peaks, mean sigma over the values, log likelihood
        and chance.
        """
        import pandas

        rows = []
        for each in self.details.maneuvers:
            row: dict[str, Any] = {"maneuver": each.kind, "pace": each.pace}
            row |= {f"peak_{name}": value for name, value in peaks_of(self.details, each).items()}
            rows.append(
                {
                    **row,
                    "mean_sigma": each.criterion,
                    "log_likelihood": each.log_likelihood,
                    "chance": each.chance,
                }
            )
        return pandas.DataFrame(rows).set_index("maneuver")

    def summary(self) -> str:
        """What the command prints."""
        return design_text(self.details)

    def save(
        self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True
    ) -> Path:
        """Write the design as the command does with ``--out``; returns the folder."""
        from scenarios.maneuver_design.report import write_design

        return write_design(self.details, Path(folder), figures=formats_wanted(figures))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    def __repr__(self) -> str:
        return f"<Design: {verdict_of(self.details)}>"

    def _repr_html_(self) -> str:
        shown = tables.of_document(maneuvers_table(self.details))
        return tables.page(verdict_of(self.details), shown)


@told_in_python
def design(
    model: Declared,
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    limits: str | PathLike[str] | Mapping[str, Any] | None = None,
    tell: Sequence[str] = (),
    size: str | Mapping[str, float] = TYPICAL,
    value: Mapping[str, float | str] | None = None,
    noise: Mapping[str, float | str] | None = None,
    amplitude: Mapping[str, float | str] | None = None,
    duration: float | None = None,
    rate: float | None = None,
    band: tuple[float, float] | None = None,
    computer: bool = False,
) -> Design:
    """Design a maneuver of each kind and compare them: ``flightid design`` in Python.

    Parameters
    ----------
    model, vehicle : as in ``identify``. limits : a TOML file, or its content: ``{"nz_max": 2.5,
    "elevator_rate": "40 deg/s"}``. tell : names of effects to be told apart, the first against each
    other one. size : ``"typical"``, ``"found"``, or values of the first effect's own parameters.
    value, noise, amplitude : derivatives, noise by output, largest deflection by input; numbers in
    SI or texts with a unit. duration, rate : s, samples a second. band : Hz; a sweep and multisines
    over it, compared by the frequency responses to expect (``coherence``). computer : a flight
    computer moves the controls; False: a pilot, who makes no quick steps and no multisines.

    Raises
    ------
    InputError : anything wrong in what is asked, in one line.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.design("rigid", "bomber_rigid", duration=20)
    <Design: FLY: doublet (step 0.76 s), elevator 4.82 deg>
    """
    asked = model_of(model)
    given = Path(limits) if isinstance(limits, str | PathLike) else limits
    source = (
        source_of(vehicle, asked if isinstance(asked, str) else "") if vehicle is not None else None
    )
    text = size if isinstance(size, str) else ",".join(_texts(size))
    names = (tell,) if isinstance(tell, str) else tuple(tell)
    return Design(
        designing.design(
            DesignRequest(
                asked,
                source,
                given,
                names,
                text,
                _texts(value),
                _texts(noise),
                _texts(amplitude),
                duration,
                rate,
                band,
                computer,
            )
        )
    )


def _texts(some: Mapping[str, Any] | None) -> tuple[str, ...]:
    return tuple(
        f"{name}={value!r}" if isinstance(value, float | int) else f"{name}={value}"
        for name, value in (some or {}).items()
    )
