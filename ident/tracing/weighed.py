"""What a claimed name was weighed against: the sets that could stand in the place of the judged one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Ground(Enum):
    """What a claim rests on: the set leaves noise; an effect was cross-validated; one-step predictions with process noise; wrong samples."""

    NOISE_LEFT = "noise left"
    CROSS_VALIDATED = "cross-validated"
    ONE_STEP = "one-step"
    SAMPLES = "samples"


@dataclass(frozen=True)
class ComparedSet:
    """One set that could stand in the place of that which is judged; the judged one is among them.

    ``misfit`` : twice the negative log likelihood on all data that took part, above that of the judged set; of what was cross-validated the
    square of how many scatters it is behind. ``price`` : what the criterion charges for its parameters and events, ``declared`` what the
    declared derivatives say against it, in the same unit and also above the judged set's. ``guard`` : one of its effects is none of the library.
    """

    names: tuple[str, ...]
    misfit: float
    price: float = 0.0
    declared: float = 0.0
    guard: bool = False


@dataclass(frozen=True)
class Weighed:
    """What the probability of a claimed name rests on: the sets compared, the judged one among them, and the ground of the claim.

    ``same`` : names under which the equations are the same (``Traits.same_as``). ``twins`` : other descriptions of the same fault among what
    was offered, which count as the name; none before its probability is asked for.
    """

    ground: Ground
    sets: tuple[ComparedSet, ...] = ()
    same: tuple[str, ...] = ()
    twins: tuple[str, ...] = ()
