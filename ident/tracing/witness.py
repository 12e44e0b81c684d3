"""What may speak of an effect by other means than the model that is fitted, such as the kinematics of the sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ident.tracing.diagnosis import Quantity

# By an effect's name and local parameters: 1 for it, -1 against it, 0 not at all.
Witness = Callable[[str, Mapping[str, Quantity]], int]


def silent(effect: str, parameters: Mapping[str, Quantity]) -> int:
    """A witness that says nothing."""
    return 0
