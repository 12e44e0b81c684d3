"""What the figures of a campaign's statistics are given."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from scenarios.plots.files import Named
from scenarios.plots.studies.consistency import CoverageRow, SquaresPanel, figure_coverage, figure_errors, figure_squares
from scenarios.studies.campaign_statistics.statistics import NORMAL, SIGMAS, CampaignStatistics


def statistics_figures(found: CampaignStatistics, title: str) -> Iterator[Named]:
    """Coverage by parameter, errors beside the normal distribution, NEES and NIS."""
    rows = [CoverageRow(p.name, tuple((100.0 * w.share, 100.0 * w.interval[0], 100.0 * w.interval[1]) for w in p.coverage)) for p in found.parameters]
    yield "coverage", partial(figure_coverage, rows, [100.0 * NORMAL[each] for each in SIGMAS], title)
    yield "normality", partial(figure_errors, found.names, found.sigmas, title)
    panels = [SquaresPanel(s.name, s.values / s.degrees, float(s.degrees.mean())) for s in (found.nees, found.nis) if s is not None]
    if panels:
        yield "consistency", partial(figure_squares, panels, title)
