"""Many scores together: shares with their intervals, over all cases and by what they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from exam.calibration import Statement, reliability
from exam.random_cases.case import CaseScore
from exam.random_cases.kinds import KINDS
from ident.statistics.intervals import clopper_pearson, clustered_share
from scenarios.report.summary import columns_of, table_lines
from scenarios.trials.planted_declaration import OWN

TWO_SIGMAS = 2.0
HEADINGS = (
    "cases",
    "of",
    "right, %",
    "95 % interval",
    "wrong, %",
    "95 % interval",
    "within 2 sigmas, %",
    "95 % interval",
)
UNPREDICTABLE = ("turbulence", "spikes")  # what is held out has its own, which no fit foretells


def summary(scores: Sequence[CaseScore]) -> dict[str, float]:
    """Shares over many cases: right, wrong claims, derivatives within two standard deviations where
    right, and the held-out error's median.
    """
    count, right = len(scores), [score for score in scores if score.right]
    free = [
        score
        for score in right
        if score.errors and not any(_unpredictable(name) for name in score.case.hidden)
    ]
    share, (low, high) = coverage(scores)
    wrong = sum(score.wrong for score in scores)
    return {
        "cases": float(count),
        "right": len(right) / count,
        "right, lower 95 %": clopper_pearson(len(right), count)[0],
        "right, upper 95 %": clopper_pearson(len(right), count)[1],
        "wrong claims": wrong / count,
        "wrong claims, upper 95 %": clopper_pearson(wrong, count)[1],
        "derivatives within two sigmas": share,
        "derivatives within two sigmas, lower 95 %": low,
        "derivatives within two sigmas, upper 95 %": high,
        "held-out error, median": float(np.median([score.held_out for score in free]))
        if free
        else 0.0,
        "seconds, median": float(np.median([score.seconds for score in scores])),
    }


def coverage(scores: Sequence[CaseScore]) -> tuple[float, tuple[float, float]]:
    """The share of derivatives within two standard deviations, over cases that are right and hide
    what a library effect names or nothing.

    Derivatives of one case are correlated: the interval counts cases.
    """
    told = [
        np.abs([*score.errors.values()])
        for score in scores
        if score.right and not score.case.outside and score.errors
    ]
    if not told:
        return 0.0, (0.0, 1.0)
    within, of = (
        np.array([np.sum(errors < TWO_SIGMAS) for errors in told]),
        np.array([len(errors) for errors in told]),
    )
    return float(within.sum() / of.sum()), clustered_share(within, of, np.random.default_rng(0))


def summary_table(scores: Sequence[CaseScore]) -> list[str]:
    """Lines of one table: all cases, those of each model, of each group, and with each kind of
    thing hidden (a pair counts for both).
    """
    rows = [_row("all", scores)]
    rows += _by(scores, lambda score: (score.case.model,))
    rows += _by(scores, lambda score: (score.case.group,))
    rows += _by(scores, lambda score: score.case.hidden)
    return table_lines(columns_of(HEADINGS, rows))


def reliability_table(statements: Sequence[Statement]) -> list[str]:
    """Lines of a table: of the names said to be so likely, how many are right."""
    rows = []
    for item in reliability(statements):
        right = f"{100.0 * item.right / item.count:.0f}" if item.count else ""
        rows.append(
            (
                f"{100 * item.low:.0f} to {100 * item.high:.0f}",
                str(item.count),
                f"{100.0 * item.said:.1f}",
                right,
                _span(item.interval),
            )
        )
    return table_lines(
        columns_of(
            ("probability said, %", "names", "mean said, %", "right, %", "95 % interval"), rows
        )
    )


def _by(
    scores: Sequence[CaseScore], names: Callable[[CaseScore], tuple[str, ...]]
) -> list[tuple[str, ...]]:
    known = sorted({name for score in scores for name in names(score)})
    return [_row(name, [score for score in scores if name in names(score)]) for name in known]


def _row(label: str, scores: Sequence[CaseScore]) -> tuple[str, ...]:
    of = len(scores)
    right, wrong = sum(score.right for score in scores), sum(score.wrong for score in scores)
    share, interval = coverage(scores)
    told = any(score.right and not score.case.outside and score.errors for score in scores)
    cells = [
        f"{100.0 * right / of:.1f}",
        _span(clopper_pearson(right, of)),
        f"{100.0 * wrong / of:.1f}",
        _span(clopper_pearson(wrong, of)),
    ]
    return (
        label,
        str(of),
        *cells,
        *((f"{100.0 * share:.1f}", _span(interval)) if told else ("", "")),
    )


def _span(interval: tuple[float, float]) -> str:
    return f"{100.0 * interval[0]:.1f} to {100.0 * interval[1]:.1f}"


def _unpredictable(name: str) -> bool:
    return OWN in KINDS[name].term or any(word in name for word in UNPREDICTABLE)
