"""The part of a diagnosis that its figures show."""

from __future__ import annotations

import numpy as np

from ident.tracing.diagnosis import Prediction, Verdict
from scenarios.diagnosis.report.data_words import kind_of_predicted, record_labels
from scenarios.diagnosis.report.declared_only import as_declared
from scenarios.diagnosis.tracing import Tracing
from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    NamedEffects,
    Pictured,
    Replicated,
)

# what a number that has run away is written as: it reads back everywhere, and its square is finite
LARGEST = 1e30


def pictured(tracing: Tracing) -> Pictured:
    """The part of a diagnosis that figures show, its runaway numbers bounded."""
    d = as_declared(tracing.diagnosis)
    predictions = tuple(
        Prediction(p.record, p.channels, bounded_series(p.before), bounded_series(p.after))
        for p in d.predictions
    )
    claimed = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    standing = NamedEffects(
        tuple(claim.name for claim in claimed),
        {claim.name: claim.alternatives for claim in claimed if claim.alternatives},
        tuple(claim.name for claim in tracing.diagnosis.effects if not claim.claimed),
        d.verdict in (Verdict.CONSISTENT, Verdict.TRACED, Verdict.AMBIGUOUS),
    )
    shown = (
        predictions,
        d.candidates,
        d.before,
        d.after,
        d.noise_floor,
        standing,
        kind_of_predicted(d),
        _replicated(tracing),
    )
    return Pictured(d.fitted, *shown, SIMULATED_DATA if tracing.simulated else MEASURED_DATA)


def _replicated(tracing: Tracing) -> tuple[Replicated, ...]:
    labels = tuple(record_labels(tracing))
    told = [claim for claim in tracing.diagnosis.effects if claim.by_record]
    return tuple(
        Replicated(claim.name, labels[: len(claim.by_record)], claim.by_record, claim.parameters)
        for claim in told
    )


def bounded_series(values: np.ndarray) -> np.ndarray:
    """Finite numbers: a simulation that ran away is written as large as it needs to be seen."""
    return np.nan_to_num(np.clip(values, -LARGEST, LARGEST), nan=LARGEST)
