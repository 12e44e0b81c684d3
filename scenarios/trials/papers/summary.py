"""Many marks together: shares with their intervals, over all papers and by what they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ident.statistics.shares import clopper_pearson, clustered_share
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.calibration import Statement, reliability
from scenarios.trials.papers.kinds import KINDS
from scenarios.trials.papers.paper import Mark
from scenarios.trials.planted.hiding import OWN

TWO_SIGMAS = 2.0
HEADINGS = ("papers", "of", "right, %", "95 % interval", "wrong, %", "95 % interval", "within 2 sigmas, %", "95 % interval")
UNPREDICTABLE = ("turbulence", "spikes")  # what is held out has its own, which no fit foretells


def summary(marks: Sequence[Mark]) -> dict[str, float]:
    """Shares over many papers: right, wrong claims, derivatives within two standard deviations where right, and the held-out error's median."""
    count, right = len(marks), [mark for mark in marks if mark.right]
    free = [mark for mark in right if mark.errors and not any(_unpredictable(name) for name in mark.paper.hidden)]
    share, (low, high) = coverage(marks)
    wrong = sum(mark.wrong for mark in marks)
    return {
        "papers": float(count),
        "right": len(right) / count,
        "right, lower 95 %": clopper_pearson(len(right), count)[0],
        "right, upper 95 %": clopper_pearson(len(right), count)[1],
        "wrong claims": wrong / count,
        "wrong claims, upper 95 %": clopper_pearson(wrong, count)[1],
        "derivatives within two sigmas": share,
        "derivatives within two sigmas, lower 95 %": low,
        "derivatives within two sigmas, upper 95 %": high,
        "held-out error, median": float(np.median([mark.held_out for mark in free])) if free else 0.0,
        "seconds, median": float(np.median([mark.seconds for mark in marks])),
    }


def coverage(marks: Sequence[Mark]) -> tuple[float, tuple[float, float]]:
    """The share of derivatives within two standard deviations, over papers that are right and hide what a library effect names or nothing.

    Derivatives of one paper are correlated: the interval counts papers.
    """
    told = [np.abs([*mark.errors.values()]) for mark in marks if mark.right and not mark.paper.outside and mark.errors]
    if not told:
        return 0.0, (0.0, 1.0)
    within, of = np.array([np.sum(errors < TWO_SIGMAS) for errors in told]), np.array([len(errors) for errors in told])
    return float(within.sum() / of.sum()), clustered_share(within, of, np.random.default_rng(0))


def summary_table(marks: Sequence[Mark]) -> list[str]:
    """Lines of one table: all papers, those of each model, of each group, and with each kind of thing hidden (a pair counts for both)."""
    rows = [_row("all", marks)]
    rows += _by(marks, lambda mark: (mark.paper.model,))
    rows += _by(marks, lambda mark: (mark.paper.group,))
    rows += _by(marks, lambda mark: mark.paper.hidden)
    return table_lines(columns_of(HEADINGS, rows))


def reliability_table(statements: Sequence[Statement]) -> list[str]:
    """Lines of a table: of the names said to be so likely, how many are right."""
    rows = []
    for item in reliability(statements):
        right = f"{100.0 * item.right / item.count:.0f}" if item.count else ""
        rows.append((f"{100 * item.low:.0f} to {100 * item.high:.0f}", str(item.count), f"{100.0 * item.said:.1f}", right, _span(item.interval)))
    return table_lines(columns_of(("probability said, %", "names", "mean said, %", "right, %", "95 % interval"), rows))


def _by(marks: Sequence[Mark], names: Callable[[Mark], tuple[str, ...]]) -> list[tuple[str, ...]]:
    known = sorted({name for mark in marks for name in names(mark)})
    return [_row(name, [mark for mark in marks if name in names(mark)]) for name in known]


def _row(label: str, marks: Sequence[Mark]) -> tuple[str, ...]:
    of = len(marks)
    right, wrong = sum(mark.right for mark in marks), sum(mark.wrong for mark in marks)
    share, interval = coverage(marks)
    told = any(mark.right and not mark.paper.outside and mark.errors for mark in marks)
    cells = [f"{100.0 * right / of:.1f}", _span(clopper_pearson(right, of)), f"{100.0 * wrong / of:.1f}", _span(clopper_pearson(wrong, of))]
    return (label, str(of), *cells, *((f"{100.0 * share:.1f}", _span(interval)) if told else ("", "")))


def _span(interval: tuple[float, float]) -> str:
    return f"{100.0 * interval[0]:.1f} to {100.0 * interval[1]:.1f}"


def _unpredictable(name: str) -> bool:
    return OWN in KINDS[name].term or any(word in name for word in UNPREDICTABLE)
