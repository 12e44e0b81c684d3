"""`flightid campaign`: Monte Carlo, printed and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.declarations import named_after
from scenarios.plots.formats import USUAL, Formats
from scenarios.studies.campaign import Campaign, Progress, fly_campaign
from scenarios.studies.campaign_causes.findings import Judgement, judge
from scenarios.studies.campaign_text import print_campaign, write_campaign
from scenarios.studies.declaration import Scenario
from scenarios.studies.runs.work import Rebuilt
from scenarios.tasks.manner import Manner, stopped
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import details_in, written_to
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.trials.planted.own_flight import OwnFlight


def own_campaign(
    asked: OwnFlight,
    runs: int,
    seed: int | None,
    manner: Manner,
    changes: Sequence[str],
    figures: Formats = USUAL,
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """The same of a user's own model in a flight that the command line describes."""
    from scenarios.studies.catalogue import with_changes
    from scenarios.studies.scenario_file.reading import scenario_of
    from scenarios.trials.planted.own_flight import study_document

    again = Rebuilt(with_changes(study_document(asked), changes), Path(asked.model).stem, asked.model)
    scenario = scenario_of(again.document, again.name, again.where)
    _run(scenario, again, runs, seed, manner, figures, levels=levels, progress=progress)


def run_campaign(
    name: str,
    runs: int,
    seed: int | None,
    manner: Manner,
    changes: Sequence[str],
    method: str | None = None,
    figures: Formats = USUAL,
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """Run, print, and write ``campaign.json`` and the runs into ``manner.out``; of a scenario of estimators by one ``method``, else its main.

    ``levels``: noise levels by likelihood even where no sigma is wrong. ``progress`` False: nothing is shown of how far it is.
    Ctrl-C leaves the table of the runs that had ended.
    """
    from scenarios.studies.catalogue import (
        IDENTIFICATION,
        load_document,
        load_scenario,
        moved,
        scenario_kind,
    )

    kind = scenario_kind(name)
    if kind == "trace":
        raise moved(f"a campaign of {name}", f"hidden-effects {name}")
    if kind != IDENTIFICATION:
        what = f"there is no campaign of a scenario of kind {kind}"
        raise DeclarationError(what, where=name, remedy="name a scenario of estimators")
    document, short, where = load_document(name, changes)
    again = Rebuilt({key: value for key, value in document.items() if key != "kind"}, short, where)
    _run(load_scenario(name, changes), again, runs, seed, manner, figures, method or "main", levels=levels, progress=progress)


def refuse_method(method: str | None) -> None:
    """Raise DeclarationError where a method is named for what has one alone."""
    if method is not None:
        raise DeclarationError("this campaign has no methods to choose from", where="--method", remedy="leave it out")


def _run(
    scenario: Scenario,
    again: Rebuilt,
    runs: int,
    seed: int | None,
    manner: Manner,
    figures: Formats,
    method: str = "main",
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    with named_after(again.where), progress_bar(progress) as tell:
        campaign = fly_campaign(scenario, runs, seed, method, tell, manner, again)
        judgement, ended = _judged(campaign, levels, tell)
    out = manner.out
    print_campaign(campaign, details=details_in(out), judgement=judgement)
    if out is not None:
        write_campaign(campaign, judgement, out, figures=figures)
        print(written_to(out))
    if len(campaign.seeds) < campaign.asked:
        raise stopped(len(campaign.seeds), campaign.asked, "runs", out)
    if not ended:
        raise KeyboardInterrupt("all runs had ended; why sigmas are wrong was not looked for to the end")


def _judged(campaign: Campaign, levels: bool, tell: Progress) -> tuple[Judgement, bool]:
    """What is said of the runs; of a campaign that was stopped no causes. False where Ctrl-C ended the search for them."""
    whole = len(campaign.seeds) == campaign.asked
    tell("whether the sigmas are right, and why not", 1.0)
    try:
        return judge(campaign, causes=whole, levels=levels), True
    except KeyboardInterrupt:
        return judge(campaign, causes=False), False
