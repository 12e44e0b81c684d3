"""What stands beside an estimate, in lines for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.statistics.intervals import LEVEL, ProfileInterval
from ident.tracing.diagnosis import Quantity
from scenarios.identification.assessment.bounds import AtBound
from scenarios.identification.assessment.prediction import RecordFit
from scenarios.studies.rows import Row
from scenarios.terminal.display_units import shown_in, spaced, unit_cell
from scenarios.terminal.numbers import number
from scenarios.terminal.paragraphs import WIDTH, wrapped
from scenarios.terminal.quantities import displayed
from scenarios.terminal.tables import columns_of, table_lines

INTERVALS = ("parameter", "unit", "from", "to", "in sigmas", "as sigma says")
PROFILED = f"profile likelihood, {100.0 * LEVEL:.0f} % intervals"
FITS = ("record", "", "channel", "rms error", "fit %", "R2", "Theil")
SIMULATED = "free simulation: initial states and biases alone are of the record itself"
LIKELIER = 0.1  # of log likelihood, by which a refit must beat the estimate to be worth a word


def bound_lines(at_bounds: Sequence[AtBound], tied: Sequence[Row]) -> list[str]:
    """A line for each parameter at a bound and each that follows others."""
    # What follows only what is held has no sigma of its own.
    sigmas = [f" +- {number(row.std, row.std)}" if row.std > 0.0 else "" for row in tied]
    followed = [f"{row.name} {number(row.estimate, row.std)}{sigma}{spaced(row.unit)}, tied" for row, sigma in zip(tied, sigmas, strict=True)]
    return [*(each.words for each in at_bounds), *followed]


def interval_lines(intervals: Sequence[ProfileInterval], units: Mapping[str, str], width: int = WIDTH) -> list[str]:
    """A table of the intervals, and a sentence on those that a sigma does not tell, each line within ``width``."""
    lines = table_lines(columns_of(INTERVALS, interval_rows(intervals, units), left=2), title=PROFILED, width=width)
    return [*lines, *(line for sentence in interval_sentences(intervals) for line in wrapped(sentence, width))]


def interval_rows(intervals: Sequence[ProfileInterval], units: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Cells below ``INTERVALS``."""
    return [
        (each.name, unit_cell(shown_in(units.get(each.name, ""), each.name).unit), *_ends(each, units), _sides(each), "" if each.agrees else "no")
        for each in intervals
    ]


def interval_sentences(intervals: Sequence[ProfileInterval]) -> list[str]:
    """What a sigma does not tell of them."""
    said: list[str] = []
    odd = [each for each in intervals if not each.agrees]
    open_ends = [f"{each.name} is open {' and '.join(_open(each))}" for each in odd if _open(each)]
    if open_ends:
        said.append(f"not determined on that side by these data: {'; '.join(open_ends)}")
    skewed = [each.name for each in odd if not _open(each)]
    if skewed:
        said.append(f"the interval is not +- 2 sigma: {', '.join(skewed)}; quote the interval")
    better = [each.name for each in intervals if each.better > LIKELIER]
    if better:
        said.append(f"likelier values than the estimate were found along {', '.join(better)}: the fit was not at its best")
    return said


def fit_lines(fits: Sequence[RecordFit], width: int = WIDTH) -> list[str]:
    """A table of what the free simulations miss, a row for each record and channel, no line longer than ``width``."""
    return table_lines(columns_of(FITS, fit_rows(fits), left=3), title=SIMULATED, width=width)


def fit_rows(fits: Sequence[RecordFit]) -> list[tuple[str, ...]]:
    """Cells below ``FITS``."""
    rows: list[tuple[str, ...]] = []
    for each in fits:
        word = "held out" if each.held_out else "fitted"
        if each.figures is None:
            rows.append((each.record.name, word, "-", "no finite simulation", "", "", ""))
            continue
        for name, error in each.figures.rmse.items():
            value, _, unit = displayed(Quantity(error, 0.0, each.record[name].unit))
            figures = f"{each.fit_percent(name):.1f}", f"{each.figures.r2[name]:.4f}", f"{each.figures.theil[name]:.3f}"
            rows.append((each.record.name, word, name, f"{value:.3g}{spaced(unit)}", *figures))
    return rows


def _ends(each: ProfileInterval, units: Mapping[str, str]) -> tuple[str, str]:
    factor = shown_in(units.get(each.name, ""), each.name).factor
    return _end(each, -1, factor), _end(each, 1, factor)


def _end(each: ProfileInterval, side: int, factor: float) -> str:
    end, at_bound = (each.low, each.low_bound) if side < 0 else (each.high, each.high_bound)
    if end is None:
        return "open"
    return number(factor * end, factor * each.sigma) + (" (bound)" if at_bound else "")


def _sides(each: ProfileInterval) -> str:
    """``"-1.8 to +2.6"``."""
    low, high = ("open" if end is None else f"{(end - each.value) / each.sigma:+.2g}" for end in (each.low, each.high))
    return f"{low} to {high}"


def _open(each: ProfileInterval) -> list[str]:
    return [word for word, end in (("below", each.low), ("above", each.high)) if end is None]
