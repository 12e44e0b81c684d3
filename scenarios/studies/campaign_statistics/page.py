"""Statistics of a campaign on its page."""

from __future__ import annotations

from scenarios.pages.model import BY_ROW, PURE, Block, Column, Prose, Table
from scenarios.pages.numbers import Cell, Number, known
from scenarios.pages.wording import sentence
from scenarios.studies.campaign_statistics.statistics import CampaignStatistics, ParameterStatistics
from scenarios.studies.campaign_statistics.text import squares_sentence
from scenarios.terminal.numbers import number

NOTE = (
    "Efficiency: variance of the Cramer-Rao bound at the reference over that of the estimates; one where nothing is lost. The bound is that of an "
    "estimator with the method's priors, which keep estimates from scattering. All intervals hold 95 %: of ratios by chi-square, of shares those of "
    "Clopper and Pearson."
)


def statistics_blocks(found: CampaignStatistics) -> list[Block]:
    """Scatter over reported sigmas with the bound; coverage within one, two and three; NEES and NIS."""
    sizes = Column("parameter"), Column("bias ± σ", BY_ROW), *(Column(each, PURE) for each in ("scatter / reported", "from", "to"))
    columns = (*sizes, Column("bound", BY_ROW), *(Column(each, PURE) for each in ("efficiency", "from", "to")))
    each = found.parameters
    tables = [
        Table("Scatter against the reported σ and the Cramer-Rao bound", columns, tuple(_size(p) for p in each), tuple(p.unit for p in each)),
        Table("Share of the runs whose interval holds the reference", _headings(), tuple(_shares(p) for p in each)),
    ]
    squares = [Prose(sentence(squares_sentence(s))) for s in (found.nees, found.nis) if s is not None]
    return [*tables, Prose(NOTE, "note"), *squares]


def _headings() -> tuple[Column, ...]:
    return Column("parameter"), *(Column(text, "%") for n in ("1 σ", "2 σ", "3 σ") for text in (f"within {n}", "from", "to"))


def _size(p: ParameterStatistics) -> tuple[Cell, ...]:
    ratio = [known(value, 3) for value in (p.ratio, *p.ratio_interval)]
    bound: Cell = "–" if p.bound is None else Number(p.bound, shown=number(p.bound, p.bound))
    ends = p.efficiency_interval or (None, None)
    return p.name, Number(p.bias, p.bias_std), *ratio, bound, *(known(value, 3) for value in (p.efficiency, *ends))


def _shares(p: ParameterStatistics) -> tuple[Cell, ...]:
    return p.name, *(Number(100.0 * value, digits=1) for within in p.coverage for value in (within.share, *within.interval))
