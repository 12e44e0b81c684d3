"""What the figures of a campaign of the loop are given."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from exam.scores.coverage import NORMAL, coverage_of
from exam.scores.probabilities import reliability_of
from exam.scores.rates import Scores, right_share, standings
from exam.scores.reliability_figure import ReliabilityBin, figure_reliability
from exam.scores.scored_flight import ScoredFlight, Standing
from exam.scores.verdict_figures import VerdictRow, figure_confusion, figure_verdicts
from scenarios.plots.drawing import Named
from scenarios.plots.studies import CoverageRow, figure_coverage

CONFUSED = "What was concluded (along) of what was hidden (up), % of its flights"


def scores_figures(scores: Scores, name: str) -> list[Named]:
    """Verdicts; conclusions where more than one thing was hidden; probabilities and parameters
    where there are any. ``name`` : of the campaign.
    """
    of = f"{name}, {len(scores.flights)} flights"
    rows = [_row(label, group) for label, group in scores.groups_and_all.items()]
    drawn: list[Named] = [
        (
            "verdicts",
            partial(
                figure_verdicts,
                rows,
                [each.value for each in Standing],
                f"Verdicts by what was hidden\n{of}",
            ),
        )
    ]
    if len(scores.groups) > 1:
        drawn.append(
            (
                "confusion",
                partial(
                    figure_confusion,
                    scores.confusion,
                    f"{CONFUSED}\n{of}",
                ),
            )
        )
    bins = [item for item in reliability_of(scores.flights) if item.count]
    if bins:
        shown = [
            _bin(item.low, item.high, item.count, item.said, item.right, item.interval)
            for item in bins
        ]
        drawn.append(
            (
                "reliability",
                partial(
                    figure_reliability, shown, f"Probabilities of names, with their number\n{of}"
                ),
            )
        )
    covered = coverage_of(scores)
    if covered:
        shares = [
            CoverageRow(
                label, tuple(_percent(share.count, share.of, share.interval) for share in each)
            )
            for label, each in covered.items()
        ]
        drawn.append(
            (
                "effect_coverage",
                partial(
                    figure_coverage,
                    shares,
                    NORMAL,
                    f"Parameters of effects within their sigmas\n{of}",
                ),
            )
        )
    return drawn


def _row(label: str, flights: Sequence[ScoredFlight]) -> VerdictRow:
    found, right = standings(flights), right_share(flights)
    share, low, high = _percent(right.count, right.of, right.interval)
    return VerdictRow(
        label,
        len(flights),
        tuple(100.0 * found[each].count / len(flights) for each in Standing),
        share,
        (low, high),
    )


def _bin(
    low: float, high: float, count: int, said: float, right: int, interval: tuple[float, float]
) -> ReliabilityBin:
    return ReliabilityBin(
        100.0 * low,
        100.0 * high,
        count,
        100.0 * said,
        100.0 * right / count,
        (100.0 * interval[0], 100.0 * interval[1]),
    )


def _percent(count: int, of: int, interval: tuple[float, float]) -> tuple[float, float, float]:
    return 100.0 * count / of, 100.0 * interval[0], 100.0 * interval[1]
