"""What speaks of effects by other means than the model, as kinematics alone do; one that says nothing where there is none."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from ident.tracing.diagnosis import Quantity


class Witness(Protocol):
    """What speaks of effects by other means than the model: of an effect's name and local parameters.

    Called, it says 1 for the effect, -1 against it, 0 not at all; ``evidence`` is the log likelihood by which it does. ``against`` is
    that by which it speaks against an effect of these values, zero or more, whatever name it has for it. ``prepare`` tells it that it is likely
    to be asked.
    """

    def prepare(self) -> None: ...
    def __call__(self, effect: str, parameters: Mapping[str, Quantity], /) -> int: ...
    def evidence(self, effect: str, parameters: Mapping[str, Quantity], /) -> float: ...
    def against(self, effect: str, parameters: Mapping[str, Quantity], /) -> float: ...


class Silent:
    """A witness that says nothing."""

    def prepare(self) -> None:
        """Nothing takes time."""

    def __call__(self, effect: str, parameters: Mapping[str, Quantity], /) -> int:
        return 0

    def evidence(self, effect: str, parameters: Mapping[str, Quantity], /) -> float:
        return 0.0

    def against(self, effect: str, parameters: Mapping[str, Quantity], /) -> float:
        return 0.0


silent = Silent()
