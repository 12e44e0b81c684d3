"""What the data of a diagnosis are called."""

from __future__ import annotations

from ident.tracing.diagnosis import Diagnosis
from scenarios.diagnosis.tracing import Tracing


def kind_of_predicted(d: Diagnosis) -> str:
    """What the predicted data are called where there is room for two words."""
    return "held out" if d.held_out else "fitted"


def record_labels(tracing: Tracing) -> list[str]:
    """The fitted records by name."""
    return [record.name for record in tracing.records]
