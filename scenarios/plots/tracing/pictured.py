"""What the figures of a diagnosis need to know, as plain data that another process can draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, eq=False)
class Replicated:
    """An effect's parameters from each of ``records`` by itself, and from the fitted ones ``together``."""

    name: str
    records: tuple[str, ...]
    by_record: tuple[Mapping[str, Quantity], ...]
    together: Mapping[str, Quantity]


@dataclass(frozen=True, eq=False)
class Pictured:
    """What the figures show of a diagnosis; ``noise`` by channel, ``claimed`` names of effects."""

    fitted: tuple[FittedRecord, ...]
    predictions: tuple[Prediction, ...]
    candidates: tuple[Candidate, ...]
    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    noise: Mapping[str, float]
    claimed: tuple[str, ...]
    kind: str
    replicated: tuple[Replicated, ...] = ()
