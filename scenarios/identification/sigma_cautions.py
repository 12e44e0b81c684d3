"""Cautions on sigmas that are smaller than the errors: gusts, lost rows, a model that is unstable; and where filter error is the method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate
from ident.statistics.residual_spectrum import common_disturbance
from ident.statistics.residuals import ResidualTest
from ident.whole_record.layout import FitSettings, lay_out
from ident.whole_record.unstable_motion import GROWN, fastest, growth
from scenarios.identification.frequency import METHOD as FREQUENCY
from sim.declaration.model import System
from sim.record import Record

# In gusts, of the worst model: the factor on sigmas with which two of them hold 95.4 % of the true
# values, that of the worst derivative, and what two hold. Measured: docs/estimators.md, Coverage.
SHORT_IN_GUSTS: Mapping[str, tuple[float, float, float]] = {
    "output-error": (1.25, 1.8, 0.91),
    FREQUENCY: (1.5, 2.1, 0.85),
}
FILTER_ERROR = (1.15, 0.92)
# Of sample intervals, the share with lost rows from which unknown inputs bias a method by more than
# half a sigma. Measured: rows dropped at random from flights with stepped inputs and white noise.
LOST_ROWS: Mapping[str, float] = {"equation-error": 0.1, "output-error": 0.05}
LONGER = 1.5  # times the usual interval: between that of one sample and of two
INTENSITY = "gust-turbulence.sigma"


def sigma_cautions(
    records: Sequence[Record],
    estimate: Estimate,
    system: System | None = None,
    tests: Sequence[ResidualTest] = (),
    local: Sequence[str] = (),
) -> tuple[str, ...]:
    """A sentence on each reason for which sigmas of the method are smaller than its errors; else nothing.

    Lost rows: see ``LOST_ROWS``. A model that is unstable at the estimate (of ``system``, with
    ``local`` parameters of each record) where one cause moves the residuals of several outputs,
    which are not white by their ``tests``. Where it is stable gusts, for output error and the
    frequency domain, by the same sign. Gusts, for filter error: their intensity is more than two
    of its sigmas.
    """
    unstable = _of_instability(records, estimate, system, tests, local) if system is not None else ()
    return (*_of_lost_rows(records, estimate), *(unstable or _of_gusts(records, estimate)))


def _of_instability(
    records: Sequence[Record], estimate: Estimate, system: System, tests: Sequence[ResidualTest], local: Sequence[str]
) -> tuple[str, ...]:
    """Errors of a free simulation grow with its unstable mode, while sigmas of output error count the sensors' noise alone."""
    if not np.all(np.isfinite(estimate.values)) or not disturbed_outputs(records, estimate, tests):
        return ()
    known = {name: value for name, value in estimate.as_dict().items() if name in system.parameters}
    found = replace(system, parameters=system.parameters.with_values(known))
    layout = lay_out(records, found, FitSettings(), local=local)
    if not GROWN <= growth(layout) < np.inf:
        return ()
    return (
        f"the model is unstable at the estimate: its free simulation doubles small errors, such as "
        f"those of inputs between samples and of rounding, every {np.log(2.0) / fastest(layout):.2g} s; "
        f"sigmas of {estimate.method} count the noise of the sensors alone and are too small, and values "
        f"may be wrong by many of them; use --method filter-error, which allows for such errors",
    )


def _of_lost_rows(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
    least, share = LOST_ROWS.get(estimate.method), lost_rows(records)
    if least is None or share < least or not any(record.inputs for record in records):
        return ()
    return (
        f"rows are lost in {100 * share:.0f} % of the sample intervals, and with them the inputs: from {100 * least:g} % "
        f"on that biases {estimate.method} by more than half a sigma where inputs step; where only outputs are missing, "
        f"keep the row and leave their cells empty",
    )


def lost_rows(records: Sequence[Record]) -> float:
    """Share of the sample intervals, of all records together, in which at least one row is lost.

    The usual interval of a record is the one that a quarter of its intervals do not exceed: half of them may be longer.
    """
    longer, count = 0, 0
    for record in records:
        gaps = np.diff(record.time)
        longer += int(np.count_nonzero(gaps > LONGER * np.quantile(gaps, 0.25)))
        count += len(gaps)
    return longer / max(count, 1)


def _of_gusts(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
    if estimate.method in SHORT_IN_GUSTS and _moved_together(records, estimate):
        factor, worst, held = SHORT_IN_GUSTS[estimate.method]
        return (
            f"one cause moves the residuals of several outputs, as gusts do: in gusts sigmas of "
            f"{estimate.method} are {factor:g} times too small, of single derivatives up to {worst:g} times (two of "
            f"them held {100 * held:.0f} % of the true values); those of equation-error hold",
        )
    if estimate.method == "filter-error" and INTENSITY in estimate.names and estimate.value(INTENSITY) > 2.0 * estimate.sigma(INTENSITY):
        factor, held = FILTER_ERROR
        return (
            f"gusts act: in gusts whose spectrum is not Dryden's sigmas of filter-error are up "
            f"to {factor:g} times too small (two of them held {100 * held:.0f} % of the true "
            f"values); those of equation-error hold",
        )
    return ()


def disturbed_outputs(records: Sequence[Record], estimate: Estimate, tests: Sequence[ResidualTest]) -> tuple[str, ...]:
    """Outputs of a free simulation whose residuals are not white, where one cause moves several of them as process noise does.

    Measured on flights of three models: of 120 with white noise of each sensor none is called so, of 120 with AR(1) noise three, of 240 in gusts all.
    """
    if estimate.method not in SHORT_IN_GUSTS or not _moved_together(records, estimate):
        return ()
    failed = (test.channel for test in tests if not test.passed and test.channel in estimate.output_names)
    return tuple(dict.fromkeys(failed))  # an output may fail more than one test


def _moved_together(records: Sequence[Record], estimate: Estimate) -> bool:
    return common_disturbance(*_residuals(records, estimate))


def _residuals(records: Sequence[Record], estimate: Estimate) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Measured minus fitted ``(m, N)`` a record, zero where a sample is missing, and which samples there are."""
    measured = [record.output_array(estimate.output_names) for record in records]
    residuals = [np.where(known, z - fitted, 0.0) for (z, known), fitted in zip(measured, estimate.fitted, strict=True)]
    return residuals, [known for _, known in measured]
