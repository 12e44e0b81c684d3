"""What the figures of a diagnosis need to know, as plain data that another process can draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.plots.display import MEASURED_DATA
from scenarios.plots.tracing.reasons import Standing


@dataclass(frozen=True, eq=False)
class Replicated:
    """An effect's parameters from each of ``records`` by itself, and from the fitted ones ``together``."""

    name: str
    records: tuple[str, ...]
    by_record: tuple[Mapping[str, Quantity], ...]
    together: Mapping[str, Quantity]


@dataclass(frozen=True, eq=False)
class Pictured:
    """What the figures show of a diagnosis; ``noise`` by channel; ``data`` is what the records are called."""

    fitted: tuple[FittedRecord, ...]
    predictions: tuple[Prediction, ...]
    candidates: tuple[Candidate, ...]
    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    noise: Mapping[str, float]
    standing: Standing
    kind: str
    replicated: tuple[Replicated, ...] = ()
    data: str = MEASURED_DATA
