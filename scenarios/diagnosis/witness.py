"""The check of the kinematics as a witness of the tracing loop: asked when a ranking hangs on it, and made once at most."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.kinematics import AGREES, CONTRADICTS, DIFFERS, Kinematics, agreements

_WORTH: Mapping[str, int] = {AGREES: 1, DIFFERS: 1, CONTRADICTS: -1}


@dataclass(frozen=True, eq=False)
class KinematicWitness:
    """Says of an effect whether the kinematics alone speak for it (1), against it (-1), or not at all (0).

    ``check`` makes the check; None where there is none to make. A fault that stands there with another value is there all the same.
    """

    check: Callable[[], Kinematics] | None

    @cached_property
    def kinematics(self) -> Kinematics | None:
        return self.check() if self.check is not None else None

    def __call__(self, effect: str, parameters: Mapping[str, Quantity]) -> int:
        if self.kinematics is None:
            return 0
        said = agreements(self.kinematics, [Claim(effect, parameters)])
        return _WORTH.get(said[0].says, 0) if said else 0
