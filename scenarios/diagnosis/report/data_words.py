"""What the data of a diagnosis are called."""

from __future__ import annotations

from ident.tracing.diagnosis import Diagnosis
from scenarios.diagnosis.tracing import Tracing


def kind_of_predicted(d: Diagnosis) -> str:
    """What the predicted data are called where there is room for two words."""
    if not d.held_out:
        return "fitted"
    return "not fitted" if d.used_to_choose else "held out"


def record_labels(tracing: Tracing) -> list[str]:
    """Records in the order of the evidence: the fitted ones, then those that were not fitted, where they took part in choosing."""
    if not tracing.diagnosis.used_to_choose:
        return [record.name for record in tracing.records]
    fitted, held = [record.name for record in tracing.records], [record.name for record in tracing.validation]
    return [*fitted, *(f"{name}, from {tracing.held_out_from:g} s" if tracing.held_out_from is not None else name for name in held)]
