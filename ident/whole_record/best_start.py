"""Where an output-error fit begins: at the declared values, or at those of equation error where the declared ones lead astray.

Equation error needs no simulation, so an unstable aircraft is as easy for it as a stable one; output error goes on from there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from math import ceil

import numpy as np

from ident.estimate import Outcome
from ident.regression.equation_error import run_equation_error
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import Fit, evaluate, fit_whole_records
from ident.whole_record.layout import FitLayout, FitSettings, lay_out
from ident.whole_record.unstable_motion import GROWN, fastest, fit_unstable, growth
from sim.declaration.model import System
from sim.errors import FlightidError
from sim.record import Record

FOLLOWED = 10.0  # e-foldings up to which a record is followed whole: with 15 and a faint motion fits take 50 steps, cut in two they take 4
PIECE = 8.0  # e-foldings of a piece at most, of a record that is not; sigmas grow by a tenth at most, with 6 by half
FEWEST = 50  # samples of a piece, which has five unknowns or more of its own
SAME = 0.1  # of log likelihood, by which two fits in one minimum may differ
RUNAWAY = 10.0  # rms of a residual, in those of the channel about its mean, from which a simulation has run away; one at rest leaves about 1


def fit_from_best_start(layout: FitLayout) -> Fit | None:
    """The output-error fit of a layout; None where no start has a finite cost.

    From the declared values where their simulation stays with the record and settles. Otherwise from equation error as well, where the record has
    all states and no prior speaks; the first fit that settles, else the one of least cost.
    """
    begun = None
    if layout.shared and layout.prior is None and quiet(layout):
        begun = evaluate(FitProblem(layout), layout.start, layout.guesses(layout.start))
    if not layout.shared or layout.prior is not None or (begun is not None and not runs_away(begun)):
        first = fit_whole_records(FitProblem(layout), begun=begun)
        if (first is not None and first.outcome is Outcome.CONVERGED) or not layout.shared or layout.prior is not None:
            return first
        return _better([first], from_regression(layout))
    return _better([], from_regression(layout), iter([layout]))


def fits_at_their_least(first: FitLayout, second: FitLayout) -> tuple[Fit | None, Fit | None]:
    """Output-error fits of two models of the same records, each at the least minimum that any start of either leads to.

    Each is fitted from the declared values and from where the other one has ended: a fit in a minimum beside the least one would say more of
    its start than of its model. Where one has settled for more than it need, equation error gives a further start to both.
    None for a model of which no start has a finite cost.
    """
    old, new = fit_from_best_start(first), fit_from_best_start(second)
    if not first.shared or first.prior is not None or second.prior is not None:
        return old, new
    begun = old, new
    old = _least(old, [_started(first, _values(new))] if new is not None else [])
    new = _least(new, [_started(second, _values(old))] if old is not None else [])
    if _settled(begun[0], old) and _settled(begun[1], new):
        return old, new
    for each in from_regression(first):
        regressed = dict(zip(each.shared, each.start.tolist(), strict=False))
        old, new = _least(old, [_started(first, regressed)]), _least(new, [_started(second, regressed)])
    return old, new


def _settled(begun: Fit | None, best: Fit | None) -> bool:
    """Whether a fit was at its least minimum already."""
    return begun is best or (begun is not None and best is not None and begun.cost - best.cost <= max(best.layout.settings.enough, SAME))


def _least(found: Fit | None, starts: Sequence[FitLayout]) -> Fit | None:
    """Of a fit and those from further starts the one of least cost."""
    fits = [found, *(fit_whole_records(FitProblem(each)) if quiet(each) else fit_unstable(each) for each in starts)]
    known = [fit for fit in fits if fit is not None and np.isfinite(fit.cost)]
    return min(known, key=lambda fit: fit.cost, default=None)


def _values(fit: Fit) -> dict[str, float]:
    return dict(zip(fit.layout.shared, fit.theta.tolist(), strict=False))


def _started(layout: FitLayout, values: Mapping[str, float]) -> FitLayout:
    """The layout with other starts of those shared parameters that have a value."""
    start = layout.start.copy()
    for i, name in enumerate(layout.shared):
        start[i] = np.clip(values.get(name, start[i]), layout.low[i], layout.high[i])
    return replace(layout, start=start)


def in_pieces(
    records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str] = (), whole: FitLayout | None = None
) -> list[list[Record]]:
    """Each record as what is fitted of it: itself, or pieces along which a motion that grows by itself can be followed.

    Each piece has its own initial state and biases. Models whose input has a memory, and fits with priors, keep their records whole.
    ``whole`` is the layout of the records as they are, where there is one already.
    """
    layout = whole or lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or system.input_stages or quiet(layout):
        return [[record] for record in records]
    rate = fastest(next(from_regression(layout), layout))
    return [_cut(record, rate * _duration(record)) for record in records]


def started_unstable(records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str] = ()) -> System | None:
    """The System started at the derivatives of equation error, where its motion grows at these and not at the declared values; else None.

    Declared values may say nothing of an aircraft being unstable. Asked where a fit from them has not settled.
    """
    layout = lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or not quiet(layout):
        return None
    begun = next(from_regression(layout), None)
    if begun is None or quiet(begun):
        return None
    return started_at(system, dict(zip(begun.shared, begun.start.tolist(), strict=False)))


def started_at(system: System, values: Mapping[str, float]) -> System:
    """The System with other starting values of some parameters."""
    return replace(system, parameters=system.parameters.with_values(values))


def put_together(parts: Sequence[np.ndarray], pieces: Sequence[Sequence[Record]]) -> tuple[np.ndarray, ...]:
    """Rows ``(m, N)`` of pieces as those of the records that they were cut from."""
    left = iter(parts)
    return tuple(np.concatenate([next(left) for _ in each], axis=1) for each in pieces)


def said_of_pieces(pieces: Sequence[Sequence[Record]]) -> str:
    """A sentence where some record was cut, else nothing."""
    count = sum(len(each) for each in pieces)
    if count == len(pieces):
        return ""
    return f"the motion is unstable by itself: it is followed in {count} pieces, each with its own initial state and biases"


def _cut(record: Record, grown: float) -> list[Record]:
    """Pieces of a record along which a motion grows by ``grown`` e-foldings, none with fewer than ``FEWEST`` samples."""
    count = min(ceil(min(grown, 1e6) / PIECE), len(record) // FEWEST)
    if grown <= FOLLOWED or count < 2:
        return [record]
    return [record.window(record.time[rows[0]], record.time[rows[-1]]) for rows in np.array_split(np.arange(len(record)), count)]


def _duration(record: Record) -> float:
    return float(record.time[-1] - record.time[0])


def quiet(layout: FitLayout, theta: np.ndarray | None = None) -> bool:
    """Whether no mode of the motion grows enough to be met in parts, at ``theta`` (the start when None)."""
    return _start_growth(layout) <= GROWN if theta is None else growth(layout, theta) <= GROWN


@lru_cache(maxsize=2)  # a fit asks for its start more than once
def _start_growth(layout: FitLayout) -> float:
    return growth(layout)


def runs_away(fit: Fit) -> bool:
    """Whether the simulation leaves a record by tenfold its own motion."""
    layout = fit.layout
    for i in np.flatnonzero(layout.used):
        known = [problem.valid[i] for problem in layout.problems]
        rows = [problem.z[i, valid] for problem, valid in zip(layout.problems, known, strict=True)]
        motion = np.concatenate([row - np.mean(row) for row in rows if row.size])
        error = np.concatenate([fit.residuals[r][i, valid] for r, valid in enumerate(known)])
        error = error - np.mean(error)  # a level apart is a bias, which the fit takes off at once
        if np.sqrt(np.mean(error**2)) > RUNAWAY * np.sqrt(np.mean(motion**2)) > 0.0:
            return True
    return False


def from_regression(layout: FitLayout) -> Iterator[FitLayout]:
    """The layout started at the values of equation error; nothing where a record does not give its states or they did not settle."""
    try:
        found = run_equation_error([problem.record for problem in layout.problems], layout.system)
    except FlightidError:
        return
    if found.outcome is not Outcome.CONVERGED or found.names != layout.shared or not np.all(np.isfinite(found.values)):
        return
    n, start = len(layout.shared), layout.start.copy()
    start[:n] = np.clip(found.values, layout.low[:n], layout.high[:n])
    yield replace(layout, start=start)


def _better(found: list[Fit | None], *starts: Iterator[FitLayout]) -> Fit | None:
    """The first fit from the starts that settles, else the best of all; of those that are ``found`` already none has."""
    fits = list(found)
    for begun in (each for some in starts for each in some):
        fit = fit_whole_records(FitProblem(begun)) if quiet(begun) else fit_unstable(begun)
        if fit is not None and fit.outcome is Outcome.CONVERGED and all(fit.cost <= other.cost for other in fits if other is not None):
            return fit
        fits.append(fit)
    known = [fit for fit in fits if fit is not None]
    return min(known, key=lambda fit: fit.cost, default=None)
