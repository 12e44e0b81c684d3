"""The page of a campaign: bias, scatter against reported sigma, share of intervals that hold the reference."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.pages.folder import figures
from scenarios.pages.model import BY_ROW, Block, Column, Page, Prose, Table, section
from scenarios.pages.numbers import Cell, Number
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.studies.campaign import Campaign, Spread
from scenarios.studies.campaign_causes.findings import Judgement
from scenarios.studies.campaign_causes.page import findings_blocks
from scenarios.studies.campaign_causes.text import cause_sentences
from scenarios.studies.campaign_statistics.page import statistics_blocks
from scenarios.terminal.numbers import number

TWO_SIGMA = 0.9545  # of a normal distribution


def campaign_page(campaign: Campaign, judgement: Judgement, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a campaign with the figures ``drawn``."""
    scenario, seeds, pooled = campaign.scenario, campaign.seeds, campaign.pooled
    low, high = pooled.interval
    wrong = judgement.findings.found
    share = f"{100 * pooled.within_two:.1f} % of all 2-sigma intervals hold the reference (95 % interval {100 * low:.1f} to {100 * high:.1f} %, "
    share += f"{100 * TWO_SIGMA:.1f} % expected)"
    worst = max(campaign.spreads, key=lambda s: abs(s.bias) / s.scatter if s.scatter > 0.0 else 0.0)
    bias = f"largest bias: {worst.name}, {abs(worst.bias) / worst.scatter:.2f} of its scatter" if worst.scatter > 0.0 else ""
    why = "; ".join(f"{count} {way}" for way, count in campaign.failures.items())
    broken = f"{campaign.broken} of {len(seeds)} runs broke down and are left out ({why})" if campaign.broken else ""
    files = [("model", file.name, file.sha256) for file in scenario.files]
    command = ["flightid", "campaign", scenario.name, "--runs", str(len(seeds)), "--seed", str(campaign.root), "--method", campaign.estimation.name]
    return Page(
        title=f"{capital(scenario.title)}: {len(seeds)} runs",
        kind=f"Campaign of {scenario.name}, {campaign.estimation.label}",
        verdict="sigmas hold" if not wrong else f"{len(wrong)} of {len(campaign.names)} sigmas wrong",
        tone="good" if not wrong else "fair",
        sentence=sentence(share),
        summary=tuple(sentence(line) for line in (bias,) if line),
        warnings=tuple(sentence(line) for line in (broken, *cause_sentences(judgement.findings)) if line),
        sections=(
            *section("Bias and scatter", *_sizes(campaign)),
            *section("Whether the sigmas are right", *findings_blocks(judgement.findings), *statistics_blocks(judgement.statistics)),
            *section("Figures", *figures(drawn)),
            *section(
                "How it was made", Prose(f"Truth and model: {scenario.distance}. Each run has a seed of its own; flightid run with it repeats one.")
            ),
        ),
        reproduction=reproduction(command, f"The seeds of all runs spring from {campaign.root}; they stand in estimates.csv.", files),
        created=now(),
    )


def _sizes(campaign: Campaign) -> list[Block]:
    headings = Column("parameter"), *(Column(each, BY_ROW) for each in ("reference", "bias ± σ", "scatter", "reported σ"))
    count = campaign.values.shape[1]
    rows = tuple(_size(s, count) for s in campaign.spreads)
    note = "Bias: mean error with the sigma of a mean. Scatter: standard deviation of the estimates. Reported: root mean square of the sigmas."
    return [Table(f"Over {count} runs", tuple(headings), rows, tuple(s.unit for s in campaign.spreads)), Prose(note, "note")]


def _size(s: Spread, count: int) -> tuple[Cell, ...]:
    return s.name, Number(s.reference), Number(s.bias, s.scatter / count**0.5), _of_two(s.scatter), _of_two(s.reported)


def _of_two(value: float) -> Cell:
    """A deviation with two digits."""
    return Number(value, shown=number(value, value))
