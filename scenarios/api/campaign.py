"""`campaign` in Python: the same study with many seeds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.api.running import KEPT, untold
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.api.study import Settings, changes_of, seed_of
from scenarios.files.declarations import named_after
from scenarios.studies import campaign as campaigns
from scenarios.studies.campaign_causes.findings import Judgement, judge
from scenarios.studies.campaign_causes.page import findings_content
from scenarios.studies.catalogue import IDENTIFICATION, load_document, moved, scenario_kind
from scenarios.studies.runs.work import Rebuilt
from scenarios.tasks.manner import Manner
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import pandas

COLUMNS = ("unit", "reference", "bias", "scatter", "reported", "within_one", "within_two")


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """Estimates of many runs against what is true. ``details``: everything that the library knows of it; ``noise_levels``: whether these are looked
    for also where no sigma is wrong."""

    details: campaigns.Campaign
    noise_levels: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The estimated parameters."""
        return self.details.names

    @property
    def values(self) -> np.ndarray:
        """Estimates, shape ``(runs, parameters)``; runs that broke down are left out."""
        return self.details.values.T

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations as reported, shape ``(runs, parameters)``."""
        return self.details.std.T

    @property
    def coverage(self) -> float:
        """Share of two-sigma intervals of all parameters that hold the reference."""
        return self.details.pooled.within_two

    @property
    def coverage_interval(self) -> tuple[float, float]:
        """Its 95 % confidence interval."""
        return self.details.pooled.interval

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a parameter: bias, scatter, reported sigma, shares of one- and two-sigma intervals that hold the reference."""
        import pandas

        spreads = self.details.spreads
        rows = [{name: getattr(each, name) for name in COLUMNS} for each in spreads]
        return pandas.DataFrame(rows, columns=list(COLUMNS), index=pandas.Index([each.name for each in spreads], name="parameter"))

    def statistics(self) -> pandas.DataFrame:
        """One row a parameter, SI: what ``statistics.csv`` holds. Bias, scatter over the reported sigma, coverage at one, two and three sigmas, each
        with its interval; the Cramer-Rao bound and the efficiency."""
        import io

        import pandas

        from scenarios.studies.campaign_statistics.content import statistics_csv

        return pandas.read_csv(io.StringIO(statistics_csv(self._judgement.statistics)), index_col="parameter")

    def wrong_sigmas(self) -> pandas.DataFrame:
        """One row a parameter whose sigma is wrong, SI: the factor that makes it right, causes, the reported and the right sigma, and the share of
        the runs within two right ones."""
        import pandas

        rows = findings_content(self._judgement.findings)["wrong_sigmas"]
        columns = ["factor", "causes", "reported_std", "right_std", "right_within_2", "right_within_2_low", "right_within_2_high", "runs"]
        return pandas.DataFrame(list(rows.values()), columns=columns, index=pandas.Index(list(rows), name="parameter"))

    @cached_property
    def _judgement(self) -> Judgement:
        return judge(self.details, levels=self.noise_levels)

    def estimates(self) -> pandas.DataFrame:
        """One row a run: its seed, each estimate and its ``std_NAME``."""
        import pandas

        pairs = {name: self.values[:, i] for i, name in enumerate(self.names)}
        return pandas.DataFrame(
            {"seed": self.details.seeds[self.details.kept], **pairs, **{f"std_{name}": self.sigmas[:, i] for i, name in enumerate(self.names)}}
        )

    def summary(self) -> str:
        """What the command prints."""
        from scenarios.studies.campaign_text import print_campaign
        from scenarios.terminal.numbers import as_text

        return as_text(lambda out: print_campaign(self.details, out, KEPT, self._judgement))

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write ``campaign.json`` and ``estimates.csv`` as the command does with ``--out``; returns the folder."""
        from scenarios.studies.campaign_text import write_campaign

        return write_campaign(self.details, self._judgement, Path(folder))

    @property
    def _title(self) -> str:
        return f"{self.details.scenario.name}, {len(self.details.seeds)} runs by {self.details.estimation.label}"

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    def __repr__(self) -> str:
        low, high = self.coverage_interval
        return f"<Campaign: {self._title}; {100 * self.coverage:.1f} % within two sigmas ({100 * low:.1f} to {100 * high:.1f} %)>"

    def _repr_html_(self) -> str:
        rows = [[each.name, *(_cell(getattr(each, name)) for name in COLUMNS)] for each in self.details.spreads]
        return html.page(self._title, html.table(("parameter", *COLUMNS), rows, left=2))


def campaign(
    name: str | PathLike[str],
    runs: int,
    *,
    seed: int | None = None,
    set: Settings = None,
    method: str | None = None,
    noise_levels: bool = False,
    jobs: int | None = None,
    out: str | PathLike[str] | None = None,
    resume: bool = False,
    cluster: str | None = None,
    time_limit: float | None = None,
) -> Campaign:
    """The same scenario with ``runs`` seeds that spring from ``seed``: bias, scatter against reported sigma, coverage; as ``flightid campaign``.

    ``noise_levels`` : find them by likelihood also where no sigma is wrong.
    ``jobs`` : processes, else one a core. ``out`` : a folder in which runs are kept as they come; ``resume`` goes on with them, ``runs`` may be more
    than before. ``cluster`` : the address of a Dask scheduler. ``time_limit`` : s that a run may take.

    Raises
    ------
    InputError : there is no such scenario or method, or ``out`` holds another campaign.
    KeyboardInterrupt : by Ctrl-C; runs that had ended are kept in ``out`` where that is given.
    """
    text = str(name)
    count = _count_of(runs)
    kind = scenario_kind(text)
    if kind == "trace":
        raise moved(f"a campaign of {text}", f"hidden-effects {text}", "campaign")
    if kind != IDENTIFICATION:
        what = f"there is no campaign of a scenario of kind {kind}"
        raise DeclarationError(what, where="campaign", remedy="name a scenario of estimators")
    manner = Manner(jobs, None if out is None else Path(out), resume, cluster, time_limit)
    document, short, where = load_document(text, changes_of(set))
    again = Rebuilt({key: value for key, value in document.items() if key != "kind"}, short, where)
    with named_after(where):
        found = campaigns.fly_campaign(again.scenario(), count, seed_of(seed), method or "main", untold, manner, again)
    if len(found.seeds) < found.asked:
        raise KeyboardInterrupt(f"{len(found.seeds)} of {count} runs had ended")  # a program must not go on as if all had
    return Campaign(found, noise_levels)


def _count_of(given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, Integral) or given < 2:
        raise DeclarationError(f"{given!r:.60} runs", where="runs", remedy="give a whole number, two or more")
    return int(given)


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
