"""A Monte-Carlo campaign printed and written."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.studies.campaign import Campaign, Spread
from scenarios.studies.campaign_causes.findings import Judgement
from scenarios.studies.campaign_causes.page import findings_content
from scenarios.studies.campaign_causes.text import print_findings
from scenarios.studies.campaign_statistics.content import statistics_content, statistics_csv
from scenarios.studies.campaign_statistics.text import print_statistics
from scenarios.studies.report.campaign import campaign_page
from scenarios.terminal.display_units import shown_in, unit_cell
from scenarios.terminal.numbers import console, number
from scenarios.terminal.summary import BELOW, Summary, print_summary
from scenarios.terminal.tables import Column, print_table


def print_campaign(campaign: Campaign, out: Console | None = None, details: str = BELOW, judgement: Judgement | None = None) -> None:
    """A summary, the table of all parameters, what is judged of its sigmas where that is given, and how many runs broke down."""
    terminal = out or console()
    seeds = campaign.seeds
    title = f"{campaign.scenario.name}: {len(seeds)} runs from seed {campaign.root}, {campaign.estimation.label}"
    spreads = tuple(_shown(s) for s in (*campaign.spreads, campaign.pooled))
    sizes = [
        Column("parameter", [s.name for s in spreads], left=True),
        Column("unit", [unit_cell(s.unit) for s in spreads], left=True),
        Column("reference", [f"{s.reference:.5g}" for s in spreads]),
        Column("bias", [number(s.bias, s.scatter / campaign.values.shape[1] ** 0.5) for s in spreads]),  # to the sigma of a mean
        Column("scatter", [number(s.scatter, s.scatter) for s in spreads]),
        Column("reported", [number(s.reported, s.reported) for s in spreads]),
    ]
    shares = [
        Column("within 2 sigma", [f"{100 * s.within_two:.1f} %" for s in spreads]),
        Column("95 % interval", [f"{100 * s.interval[0]:.1f} to {100 * s.interval[1]:.1f} %" for s in spreads]),
    ]
    pooled, low_high = campaign.pooled, " to ".join(f"{100 * end:.1f}" for end in campaign.pooled.interval)
    settled = f"{len(seeds) - campaign.broken} of {len(seeds)} runs settled"
    result = f"within 2 sigma {100 * pooled.within_two:.1f} % (95 % interval {low_high} %), within 1 sigma {100 * pooled.within_one:.1f} %"
    print_summary(terminal, Summary(title, settled, result, details=details))
    print_table(terminal, title, [*sizes, *shares])
    if judgement is not None:
        print_statistics(judgement.statistics, terminal)
        print_findings(judgement.findings, terminal)
    if campaign.broken:
        terminal.print(broken_words(campaign))


def broken_words(campaign: Campaign) -> str:
    """How many runs are left out, and by what they ended."""
    why = "; ".join(f"{count} {way}" for way, count in campaign.failures.items())
    return f"{campaign.broken} of {len(campaign.seeds)} runs broke down and are left out ({why})"


def _shown(s: Spread) -> Spread:
    """The same in the unit in which it is shown."""
    factor, unit = shown_in(s.unit, s.name)
    sizes = {key: factor * getattr(s, key) for key in ("reference", "bias", "scatter", "reported")}
    return replace(s, unit=unit, **sizes)


def write_campaign(campaign: Campaign, judgement: Judgement, out: Path, *, figures: Formats = USUAL) -> Path:
    """Write ``campaign.json``, ``statistics.csv``, ``estimates.csv``, figures and the page into ``out``, whole or not at all; returns it."""
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["seed", *(column for name in campaign.names for column in (name, f"std_{name}"))])
        sound = campaign.seeds[campaign.kept].tolist()
        for seed, value, std in zip(sound, campaign.values.T.tolist(), campaign.std.T.tolist(), strict=True):
            writer.writerow([seed, *(repr(cell) for pair in zip(value, std, strict=True) for cell in pair)])
        (scratch / "statistics.csv").write_text(statistics_csv(judgement.statistics), encoding="utf-8", newline="\n")
        (scratch / "estimates.csv").write_text(text.getvalue(), encoding="utf-8", newline="\n")
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.studies.figures import campaign_figures

            drawn = drawn_for_page(campaign_figures(campaign, judgement.statistics), scratch, figures)
        write_page(scratch, campaign_page(campaign, judgement, drawn))
        content = {
            "schema": "flightid/campaign/1",
            "scenario": campaign.scenario.name,
            "method": campaign.estimation.name,
            "seed": campaign.root,
            "runs": len(campaign.seeds),
            **({"asked": campaign.asked} if campaign.asked > len(campaign.seeds) else {}),
            "broken": campaign.broken,
            **({"failures": dict(campaign.failures)} if campaign.failures else {}),
            "parameters": {s.name: _spread(s) for s in campaign.spreads},
            "pooled": {
                "within_one_sigma": campaign.pooled.within_one,
                "within_two_sigma": campaign.pooled.within_two,
                "interval": list(campaign.pooled.interval),
            },
            "statistics": statistics_content(judgement.statistics),
            **findings_content(judgement.findings),
            "versions": versions(),
        }
        write_json(scratch / "campaign.json", content)
    return out


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
