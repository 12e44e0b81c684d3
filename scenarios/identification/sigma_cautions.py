"""By how much the sigmas of a method are too small where it has been measured, as a caution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.estimate import Estimate
from ident.statistics.residual_spectrum import common_disturbance
from scenarios.identification.frequency import METHOD as FREQUENCY
from sim.record import Record

# In gusts, of the worst model: factor on sigmas with which two of them hold 95.4 % of the true values, and what two hold without it.
# Measured: docs/estimators.md, Coverage.
SHORT_IN_GUSTS: Mapping[str, tuple[float, float]] = {
    "output-error": (1.3, 0.87),
    FREQUENCY: (1.5, 0.84),
}


def sigma_cautions(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
    """A sentence where residuals of several outputs move together and the method takes no account of what moves them; else nothing."""
    if estimate.method not in SHORT_IN_GUSTS:
        return ()
    measured = [record.output_array(estimate.output_names) for record in records]
    residuals = [np.where(known, z - fitted, 0.0) for (z, known), fitted in zip(measured, estimate.fitted, strict=True)]
    if not common_disturbance(residuals, [known for _, known in measured]):
        return ()
    factor, held = SHORT_IN_GUSTS[estimate.method]
    return (
        f"one cause moves the residuals of several outputs, as gusts do: in gusts sigmas of {estimate.method} are up to {factor:g} times too small "
        f"(two of them held {100 * held:.0f} % of the true values); those of equation-error hold, and those of filter-error nearly",
    )
