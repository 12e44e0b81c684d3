"""`flightid campaign`: Monte Carlo, printed and written."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.commands.failures import named_after
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.studies.campaign import Campaign, Spread, fly_campaign
from scenarios.studies.declaration import Scenario
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from scenarios.trials.planted.own_flight import OwnFlight

LOOP = ("false-alarms", "clean-models", "weak-effects", "random-papers")  # campaigns of the tracing loop itself


def own_campaign(asked: OwnFlight, runs: int, seed: int | None, out: Path | None, changes: Sequence[str], figures: Formats) -> None:
    """The same of a user's own model in a flight that the command line describes."""
    from scenarios.studies.catalogue import with_changes
    from scenarios.studies.scenario_file.reading import scenario_of
    from scenarios.trials.planted.own_flight import study_document

    scenario = scenario_of(with_changes(study_document(asked), changes), Path(asked.model).stem, asked.model)
    _run(scenario, asked.model, runs, seed, out, figures)


def run_campaign(
    name: str, runs: int, seed: int | None, out: Path | None, changes: Sequence[str], method: str | None = None, figures: Formats = USUAL
) -> None:
    """Run, print, and write ``campaign.json``, ``estimates.csv`` and its figure into ``out``; of a scenario of estimators by one ``method``,
    else its main."""
    from scenarios.studies.catalogue import IDENTIFICATION, load_scenario, scenario_file, scenario_kind

    kind = "" if name in LOOP else scenario_kind(name)
    if kind != IDENTIFICATION:
        refuse_method(method)
    if name in LOOP:
        from scenarios.commands.trials import run_trials

        run_trials(name, runs, seed, out, changes)
        return
    if kind == "standin":
        from scenarios.commands.standin import standin_campaign

        standin_campaign(name, runs, seed, out, changes)
        return
    _run(load_scenario(name, changes), scenario_file(name), runs, seed, out, figures, method or "main")


def refuse_method(method: str | None) -> None:
    """Raise DeclarationError where a method is named for what has one alone."""
    if method is not None:
        raise DeclarationError("this campaign has no methods to choose from", where="--method", remedy="leave it out")


def _run(scenario: Scenario, file: str, runs: int, seed: int | None, out: Path | None, figures: Formats, method: str = "main") -> None:
    with named_after(file):
        campaign = fly_campaign(scenario, runs, seed, method)
    _print(campaign)
    if out is not None:
        _write(campaign, out, figures)
        print(f"written to {out}")


def _print(campaign: Campaign, out: Console | None = None) -> None:
    from scenarios.terminal.numbers import console, number
    from scenarios.terminal.tables import Column, print_table

    terminal = out or console()
    seeds = campaign.seeds
    title = f"{campaign.scenario.name}: {len(seeds)} runs, seeds {seeds[0]} to {seeds[-1]}, {campaign.estimation.label}"
    spreads = (*campaign.spreads, campaign.pooled)
    sizes = [
        Column("parameter", [s.name for s in spreads], left=True),
        Column("unit", [s.unit for s in spreads], left=True),
        Column("reference", [f"{s.reference:.5g}" for s in spreads]),
        Column("bias", [number(s.bias, s.scatter) for s in spreads]),
        Column("scatter", [number(s.scatter, s.scatter) for s in spreads]),
        Column("reported", [number(s.reported, s.reported) for s in spreads]),
    ]
    shares = [
        Column("within 2 sigma", [f"{100 * s.within_two:.1f} %" for s in spreads]),
        Column("95 % interval", [f"{100 * s.interval[0]:.1f} to {100 * s.interval[1]:.1f} %" for s in spreads]),
        Column("in 1 sigma", [f"{100 * s.within_one:.1f} %" for s in spreads]),
    ]
    print_table(terminal, title, [*sizes, *shares])
    if campaign.broken:
        terminal.print(f"{campaign.broken} of {len(seeds)} runs broke down and are left out")


def _write(campaign: Campaign, out: Path, figures: Formats) -> None:
    from scenarios.files.folders import study_folder
    from scenarios.files.versions import versions
    from scenarios.files.writing import write_json
    from scenarios.pages.folder import write_page
    from scenarios.studies.report.campaign import campaign_page

    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column for name in campaign.names for column in (name, f"std_{name}")])
        for value, std in zip(campaign.values.T.tolist(), campaign.std.T.tolist(), strict=True):
            writer.writerow([repr(cell) for pair in zip(value, std, strict=True) for cell in pair])
        (scratch / "estimates.csv").write_text(text.getvalue(), encoding="utf-8")
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page

            drawn = drawn_for_page([("campaign", partial(_figure, campaign))], scratch, figures)
        write_page(scratch, campaign_page(campaign, drawn))
        content = {
            "schema": "flightid/campaign/1",
            "scenario": campaign.scenario.name,
            "method": campaign.estimation.name,
            "first_seed": campaign.seeds[0],
            "runs": len(campaign.seeds),
            "broken": campaign.broken,
            "parameters": {s.name: _spread(s) for s in campaign.spreads},
            "pooled": {
                "within_one_sigma": campaign.pooled.within_one,
                "within_two_sigma": campaign.pooled.within_two,
                "interval": list(campaign.pooled.interval),
            },
            "versions": versions(),
        }
        write_json(scratch / "campaign.json", content)


def _figure(campaign: Campaign) -> Figure:
    from scenarios.plots.studies.campaign import Coverage, figure_campaign

    def row(spread: Spread, sigmas: np.ndarray) -> Coverage:
        low, high = spread.interval
        return Coverage(spread.name, sigmas, 100.0 * spread.within_two, (100.0 * low, 100.0 * high))

    reference = np.array([[spread.reference] for spread in campaign.spreads])
    sigmas = (campaign.values - reference) / campaign.std
    rows = [row(spread, each) for spread, each in zip(campaign.spreads, sigmas, strict=True)]
    title = f"{campaign.scenario.title}\n{campaign.estimation.label}: {sigmas.shape[1]} runs"
    return figure_campaign([*rows, row(campaign.pooled, sigmas.ravel())] if len(rows) > 1 else rows, title)


def _spread(s: Spread) -> dict[str, Any]:
    return {
        "unit": s.unit,
        "reference": s.reference,
        "bias": s.bias,
        "scatter": s.scatter,
        "reported_std": s.reported,
        "within_one_sigma": s.within_one,
        "within_two_sigma": s.within_two,
        "interval": list(s.interval),
    }
