"""The result of a campaign of the tracing loop: verdicts, names, their probabilities and sigmas over many flights whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api.running import KEPT
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.plots.formats import formats_wanted
from scenarios.terminal.paragraphs import WIDTH
from scenarios.trials.campaigns import LoopCampaign
from scenarios.trials.marks.coverage import SIGMAS, coverage_of
from scenarios.trials.marks.marked import Standing
from scenarios.trials.marks.probabilities import Brier, brier, reliability_of
from scenarios.trials.marks.rates import Marks, false_share, right_share, standings
from scenarios.trials.marks.tables import RATES, rate_rows
from scenarios.trials.repeated import Flown

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class CampaignOfTheLoop:
    """Flights whose truth the loop did not see, and what it said of them. ``details``: everything that the library knows of them."""

    details: Flown
    campaign: LoopCampaign

    @cached_property
    def marks(self) -> Marks:
        """The flights, each marked, with what it is counted under."""
        return self.campaign.marks(self.details.found)

    @property
    def false_names(self) -> tuple[float, float, float]:
        """The share of flights with nothing hidden in which something is named, and its exact 95 % interval; NaN to begin with where none is."""
        share = false_share([each for each in self.marks.flights if not each.hidden])
        return (share.count / share.of if share.of else float("nan")), *share.interval

    @property
    def brier(self) -> Brier | None:
        """Brier score of the names that are given, with its interval; None where none is."""
        return brier(self.marks.flights)

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a flight: what was hidden, the verdict, the name given and its probability, errors in sigmas, held-out errors over the noise."""
        import pandas

        return pandas.DataFrame([dict(self.campaign.cells(each)) for each in self.details.found])

    def statistics(self) -> pandas.DataFrame:
        """One row for each thing that was hidden, and for all flights: how many are answered right, with the exact 95 % interval of that share, and
        how many end in which way."""
        import pandas

        rows = {}
        for label, group in self.marks.groups_and_all.items():
            right, found = right_share(group), standings(group)
            low, high = right.interval
            shares = {"flights": right.of, "right": right.count, "share": right.count / right.of, "low": low, "high": high}
            rows[label] = {**shares, **{each.value: found[each].count for each in Standing}}
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("hidden")

    def confusion(self) -> pandas.DataFrame:
        """What was hidden, by row, against what was concluded: numbers of flights."""
        import pandas

        return pandas.DataFrame.from_dict({**self.marks.confusion}, orient="index").fillna(0).astype(int).rename_axis("hidden")

    def reliability(self) -> pandas.DataFrame:
        """One row a range of probabilities: names that were given one, the mean of it, the share of them that is right with its exact interval."""
        import pandas

        columns = ["from", "to", "names", "said", "right", "low", "high"]
        rows = [
            (b.low, b.high, b.count, b.said, b.right / b.count if b.count else float("nan"), *b.interval) for b in reliability_of(self.marks.flights)
        ]
        return pandas.DataFrame(rows, columns=columns)

    def coverage(self) -> pandas.DataFrame:
        """One row for each thing that was hidden: the share of its parameters within one, two and three reported sigmas, with intervals."""
        import pandas

        rows = {}
        for label, shares in coverage_of(self.marks).items():
            each: dict[str, Any] = {"parameters": shares[0].of}
            for k, share in zip(SIGMAS, shares, strict=True):
                each |= {f"within_{k}": share.count / share.of, f"low_{k}": share.interval[0], f"high_{k}": share.interval[1]}
            rows[label] = each
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("hidden")

    def summary(self) -> str:
        """What the command prints."""
        return self.campaign.text(self.details, WIDTH, KEPT)

    def save(self, folder: str | PathLike[str], *, figures: bool | str = True) -> Path:
        """Write ``campaign.json``, ``flights.csv``, figures and the page as the command does with ``--out``; returns the folder."""
        return self.campaign.write(self.details, Path(folder), formats_wanted(figures))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    def __repr__(self) -> str:
        right = right_share(self.marks.flights)
        low, high = (100.0 * end for end in right.interval)
        return f"<CampaignOfTheLoop: {self._title}; {right.count} of {right.of} answered right ({low:.1f} to {high:.1f} %)>"

    def _repr_html_(self) -> str:
        return html.page(self._title, html.table(RATES, rate_rows(self.marks)))

    @property
    def _title(self) -> str:
        return f"{self.campaign.name}, {self.details.ended} flights"
