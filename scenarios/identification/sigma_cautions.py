"""By how much the sigmas of a method are too small where it has been measured, as a caution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.estimate import Estimate
from ident.statistics.residual_spectrum import common_disturbance
from scenarios.identification.frequency import METHOD as FREQUENCY
from sim.record import Record

# In gusts, of the worst model: the factor on sigmas with which two of them hold 95.4 % of the true
# values, and what two hold without it. Measured: docs/estimators.md, Coverage.
SHORT_IN_GUSTS: Mapping[str, tuple[float, float]] = {
    "output-error": (1.3, 0.85),
    FREQUENCY: (1.5, 0.83),
}
FILTER_ERROR = (1.15, 0.92)
INTENSITY = "gust-turbulence.sigma"


def sigma_cautions(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
    """A sentence where gusts act and sigmas of the method are too small in gusts; else nothing.

    Output error and the frequency domain: one cause moves the residuals of several outputs.
    Filter error: the intensity of the gusts is more than two of its sigmas.
    """
    if estimate.method in SHORT_IN_GUSTS and _moved_together(records, estimate):
        factor, held = SHORT_IN_GUSTS[estimate.method]
        return (
            f"one cause moves the residuals of several outputs, as gusts do: in gusts sigmas of "
            f"{estimate.method} are up to {factor:g} times too small (two of them held "
            f"{100 * held:.0f} % of the true values); those of equation-error hold",
        )
    if estimate.method == "filter-error" and INTENSITY in estimate.names and estimate.value(INTENSITY) > 2.0 * estimate.sigma(INTENSITY):
        factor, held = FILTER_ERROR
        return (
            f"gusts act: in gusts whose spectrum is not Dryden's sigmas of filter-error are up "
            f"to {factor:g} times too small (two of them held {100 * held:.0f} % of the true "
            f"values); those of equation-error hold",
        )
    return ()


def _moved_together(records: Sequence[Record], estimate: Estimate) -> bool:
    measured = [record.output_array(estimate.output_names) for record in records]
    residuals = [np.where(known, z - fitted, 0.0) for (z, known), fitted in zip(measured, estimate.fitted, strict=True)]
    return common_disturbance(residuals, [known for _, known in measured])
