"""`check` in Python: what the kinematics alone say of the sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api import plot
from scenarios.api.asking import Found, Named, Source, Times, plan_from, request_of, with_parts
from scenarios.api.records.opening import Choices
from scenarios.api.running import KEPT
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.api.vehicle import Vehicle
from scenarios.compatibility import check as checking
from scenarios.compatibility.text import finding_lines
from scenarios.plots.formats import formats_wanted

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Check:
    """What the kinematics say of the sensors. ``details``: everything that the library knows of it."""

    details: checking.Check

    @property
    def findings(self) -> tuple[str, ...]:
        """Names of the sensor faults that stand, ``"delay:alpha"`` and the like."""
        return tuple(dict.fromkeys(finding.name for finding in self.details.result.findings if finding.stands))

    @property
    def sentences(self) -> tuple[str, ...]:
        """What stands and what cannot be told, one sentence each."""
        return tuple(finding_lines(self.details))

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that took part."""
        return tuple(self.details.result.channels)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the records, one sentence each."""
        return (*self.details.look.doubts, *self.details.look.set_aside)

    @property
    def notes(self) -> tuple[str, ...]:
        """How the records were prepared, one sentence each."""
        return (*self.details.notes, *self.details.result.notes)

    def summary(self) -> str:
        """What the command prints."""
        from scenarios.compatibility.text import print_check
        from scenarios.terminal.numbers import as_text

        return as_text(lambda out: print_check(self.details, out, KEPT))

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a sensor fault, from all records together: value and sigma by output error and by the smoother, gain, p, whether it stands."""
        import pandas

        stands = set(self.findings)
        rows = [
            {
                "fault": item.name,
                "unit": item.unit,
                "value": item.output_error.value,
                "sigma": item.output_error.std,
                "smoother_value": item.smoother.value,
                "smoother_sigma": item.smoother.std,
                "gain": item.gain,
                "p_value": item.p_value,
                "stands": item.name in stands,
            }
            for item in self.details.result.joint.estimates
        ]
        columns = ["fault", "unit", "value", "sigma", "smoother_value", "smoother_sigma", "gain", "p_value", "stands"]
        return pandas.DataFrame(rows, columns=columns).set_index("fault")

    def to_dict(self) -> dict[str, Any]:
        """Content of ``compatibility.json``."""
        from scenarios.compatibility.files import check_content

        return check_content(self.details)

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path:
        """Write the study as the command does with ``--out``; returns the folder."""
        from scenarios.compatibility.files import write_check

        return write_check(self.details, Path(folder), figures=formats_wanted(figures))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.reconstruction()``."""
        return plot.Figures(self, plot.reconstruction)

    def __repr__(self) -> str:
        names = ", ".join(record.name for record in self.details.records)
        return f"<Check of {names:.200}: {'; '.join(self.sentences) or 'nothing stands':.600}>"

    def _repr_html_(self) -> str:
        names = ", ".join(record.name for record in self.details.records)
        return html.page(f"data compatibility of {names}", html.sentences(self.sentences), html.sentences(self.warnings))


def check(
    records: Source | Sequence[Source],
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    channels: Choices | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: Named = None,
    maneuvers: Found = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    trust_record: bool = False,
) -> Check:
    """What the kinematics alone say of the sensors: ``flightid check`` in Python; parameters as in ``identify``.

    Raises
    ------
    InputError : anything in the records that keeps them from being used, in one line.
    """
    plan = plan_from(start, stop, hold, rate, lowpass, trust_record, columns)
    request = with_parts(request_of(records, "", vehicle, channels=channels, plan=plan), maneuver, maneuvers)
    return Check(checking.check_files(request))
