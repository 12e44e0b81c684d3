"""Statistics of a campaign in the terminal."""

from __future__ import annotations

import math

from rich.console import Console

from scenarios.studies.campaign_statistics.statistics import CampaignStatistics, ParameterStatistics, Squares
from scenarios.terminal.numbers import number
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.tables import Column, print_table

MEANINGS = {"NEES": "squared error in units of the reported covariance, all parameters together", "NIS": "squared innovation in units of its own"}


def print_statistics(found: CampaignStatistics, out: Console) -> None:
    """A row a parameter: scatter over reported sigma, coverage, efficiency; below it NEES and NIS."""
    each = found.parameters
    columns = [
        Column("parameter", [p.name for p in each], left=True),
        Column("bias/its sigma", [f"{p.bias / p.bias_std:+.1f}" if p.bias_std > 0.0 else "-" for p in each]),
        Column("scatter/reported", [_ratio(p.ratio, p.ratio_interval) for p in each]),
        *(Column(f"in {n} sigma", [f"{100 * p.coverage[n - 1].share:.1f} %" for p in each]) for n in (1, 2, 3)),
        Column("efficiency", [efficiency_text(p) for p in each]),
    ]
    out.print()
    print_table(out, "scatter over the reported sigma (95 % interval), coverage (a normal distribution's: 68.3, 95.4, 99.7 %), efficiency", columns)
    for squares in (found.nees, found.nis):
        if squares is not None:
            print_paragraph(out, squares_sentence(squares), 0)


def efficiency_text(p: ParameterStatistics) -> str:
    """Variance of the bound over that of the estimates with its interval, or a dash."""
    if p.efficiency is None or p.efficiency_interval is None or not math.isfinite(p.efficiency_interval[1]):
        return "-"
    return _ratio(p.efficiency, p.efficiency_interval)


def squares_sentence(squares: Squares) -> str:
    """The mean of NEES or NIS over its degrees of freedom beside where it should be."""
    low, high = squares.interval
    said = "as it should be" if squares.right else "too large" if squares.mean > high else "too small"
    return (
        f"{squares.name} ({MEANINGS[squares.name]}) over its degrees of freedom: {_near_one(squares.mean)}, {said} (95 % of right ones "
        f"{low:.3f} to {high:.3f}); {100 * squares.inside:.1f} % of the runs within their own 95 % interval"
    )


def _near_one(value: float) -> str:
    return f"{value:.3f}" if value < 100.0 else number(value)


def _ratio(value: float, interval: tuple[float, float]) -> str:
    if not math.isfinite(value) or not math.isfinite(interval[1]):
        return "-"
    digits = 2 if value < 100.0 else 0
    return f"{value:.{digits}f} ({interval[0]:.{digits}f} to {interval[1]:.{digits}f})"
