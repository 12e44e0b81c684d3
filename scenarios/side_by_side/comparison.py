"""Which parameters studies share, in which order, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from scenarios.side_by_side.value import Column, Value
from sim.errors import DeclarationError
from sim.vehicles.factory import BALLISTIC_DERIVATIVES, LOES_DERIVATIVES, LOES_OFFSETS, RIGID_DERIVATIVES, WHOLE_AXES, mode_units

MODES = 9  # as many elastic modes have an order of their own
FEWEST = 2


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Studies beside each other.

    ``names``: parameters that at least two of them estimate, in the order of the equations; ``units`` of these; ``derived``: derived
    quantities likewise; ``single``: parameters that only one estimates, by name of its column; ``apart``: what has the same name in
    several studies and another unit in each, which is not compared.
    """

    columns: tuple[Column, ...]
    names: tuple[str, ...]
    derived: tuple[str, ...]
    single: dict[str, tuple[str, ...]]
    apart: tuple[str, ...]

    def value(self, name: str, column: Column) -> Value | None:
        """What a column says of a parameter or derived quantity; None where it says nothing."""
        return column.values.get(name) if name in self.names else column.derived.get(name)

    def words(self, name: str) -> str:
        """How a row is called: a parameter by its name, a derived quantity in words."""
        return name if name in self.names else name.replace("_", " ")

    def unit(self, name: str) -> str:
        """The one unit of a parameter or derived quantity."""
        return next(value.unit for column in self.columns if (value := self.value(name, column)) is not None)


def compare_columns(columns: Sequence[Column]) -> SideBySide:
    """Studies side by side.

    Raises
    ------
    DeclarationError : fewer than two of them, or no parameter that two of them estimate.
    """
    if len(columns) < FEWEST:
        raise DeclarationError("one study has nothing beside it", where=columns[0].label if columns else "compare", remedy="name at least two")
    held = [dict(column.values) for column in columns]
    apart = tuple(name for name in _ordered({name for values in held for name in values}) if len(_units(name, held)) > 1)
    counted = {name: sum(name in values for values in held) for values in held for name in values}
    names = _ordered({name for name, count in counted.items() if count >= FEWEST and name not in apart})
    if not names:
        what = f"{', '.join(column.label for column in columns)} share no parameter"
        remedy = f"in the same unit: {', '.join(apart)}" if apart else "; ".join(f"{c.label} has {_few(list(c.values))}" for c in columns)
        raise DeclarationError(what, where="compare", remedy=f"name studies of one model ({remedy})")
    single = {c.label: found for c in columns if (found := _ordered({name for name in c.values if counted[name] == 1}))}
    derived = [dict(column.derived) for column in columns]
    both = {name for values in derived for name in values if sum(name in other for other in derived) >= FEWEST and len(_units(name, derived)) == 1}
    return SideBySide(tuple(columns), names, _ordered(both - set(names)), single, apart)


def _units(name: str, held: Sequence[dict[str, Value]]) -> set[str]:
    return {values[name].unit for values in held if name in values}


def _few(names: Sequence[str]) -> str:
    shown = _ordered(set(names))
    return ", ".join(shown[:3]) + (", ..." if len(shown) > 3 else "") if shown else "none"


def _ordered(names: set[str]) -> tuple[str, ...]:
    """In the order of the equations; what these do not know after it by name, numbers in it as numbers."""
    known = [*RIGID_DERIVATIVES, *(name for name, _, _ in mode_units(MODES)), *BALLISTIC_DERIVATIVES, *LOES_DERIVATIVES, *LOES_OFFSETS]
    known += [name for _, _, derivatives in WHOLE_AXES.values() for name in derivatives]
    place = {name: at for at, name in reversed(list(enumerate(known)))}

    def key(name: str) -> tuple[int, list[tuple[int, str]]]:
        parts = [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
        return place.get(name, len(known)), parts

    return tuple(sorted(names, key=key))
