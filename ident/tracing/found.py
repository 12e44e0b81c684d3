"""What the stages of the loop hand on: the declared model fitted, and what a search ends with."""

from __future__ import annotations

from dataclasses import dataclass

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Claim
from ident.tracing.replication.partial import Partial
from ident.tracing.selection.ledger import Ledger
from ident.tracing.validation.held_out import HeldOutData


@dataclass(frozen=True, eq=False)
class Declared:
    """The declared model fitted, provisional spikes set aside; ``spikes`` those of recorded inputs, which were mended."""

    ledger: Ledger
    root: FittedModel
    spikes: tuple[Claim, ...]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search ends with.

    ``base`` : the declared model with what any record may have, where the best set has it. ``partial`` : effects that replicate, None where
    none does; ``asked`` whether that was asked.
    """

    ledger: Ledger
    root: FittedModel
    base: FittedModel
    best: FittedModel
    held: HeldOutData
    partial: Partial | None
    asked: bool
    spikes: tuple[Claim, ...]
