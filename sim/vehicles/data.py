"""Numbers of a vehicle with their units and origins, and how two sets differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from sim.declaration.parameters import Parameter, ParameterSet
from sim.errors import DeclarationError


class Origin(Enum):
    """Where a number comes from, by the mark it carries in a data file."""

    PUBLISHED = "pub"
    PAPER = "pap"
    CONVERTED = "conv"
    OWN = "own"
    REMEMBERED = "rem"
    USER = "user"

    @property
    def words(self) -> str:
        """What the mark means, for everything that shows the number."""
        return _WORDS[self]


_WORDS = {
    Origin.PUBLISHED: "read in the named publication or its reprint",
    Origin.PAPER: "printed in the paper on simulated flight data",
    Origin.CONVERTED: "published for the same aircraft at another flight condition and converted",
    Origin.OWN: "chosen or computed by this project, not flight data",
    Origin.REMEMBERED: "commonly quoted for this vehicle, source not at hand, not verified",
    Origin.USER: "given by the user",
}


@dataclass(frozen=True)
class Number:
    """One number of a vehicle.

    Attributes
    ----------
    name, value, unit : as a Parameter has them, SI.
    printed : as its source has it, with that source's unit; empty for a user's own.
    origin : where it comes from.
    note : what else is to be said of it.
    printed_by_paper : what the paper prints where that is known to be a misprint; never used in a computation.
    """

    name: str
    value: float
    unit: str
    printed: str = ""
    origin: Origin = Origin.USER
    note: str = ""
    printed_by_paper: str = ""

    @property
    def source(self) -> str:
        """Origin and note in one line."""
        return f"{self.origin.words}: {self.note}" if self.note else self.origin.words


@dataclass(frozen=True)
class VehicleData:
    """A named set of numbers from one source.

    Attributes
    ----------
    name, title, source : the set's key, what it is, where it is from.
    equations : name of the base equations, such as ``"rigid"`` or ``"lateral"``.
    numbers : of the parameters, those of elastic modes by full name (``omega1``, ``CL_eta1``, ``Ceta1_eta2``).
    initial : starting state, by state name; a state that is missing starts at zero.
    modes : how many elastic modes it has.
    based_on : name of the set it was built on.
    """

    name: str
    title: str
    source: str
    equations: str
    numbers: tuple[Number, ...]
    initial: tuple[Number, ...] = ()
    modes: int = 0
    based_on: str = ""

    def __contains__(self, name: object) -> bool:
        return any(number.name == name for number in self.numbers)

    def __getitem__(self, name: str) -> Number:
        for number in self.numbers:
            if number.name == name:
                return number
        raise DeclarationError(f"the number {name} is missing", where=f"vehicle {self.name}", remedy="give it")

    @property
    def values(self) -> Mapping[str, float]:
        """Values by name, SI."""
        return {number.name: number.value for number in self.numbers}

    @property
    def parameters(self) -> ParameterSet:
        """All numbers as parameters with their source text, none of them free."""
        return ParameterSet(tuple(Parameter(n.name, n.value, n.unit, free=False, source=n.source) for n in self.numbers))


@dataclass(frozen=True)
class Difference:
    """A number that two sets do not share; None where a set lacks it."""

    name: str
    first: Number | None
    second: Number | None


def difference(a: VehicleData, b: VehicleData) -> tuple[Difference, ...]:
    """Numbers whose value or unit differs between two sets, or that only one has, in the order of ``a``, then ``b``."""
    first, second = {n.name: n for n in a.numbers}, {n.name: n for n in b.numbers}
    pairs = (Difference(name, first.get(name), second.get(name)) for name in {**first, **second})
    return tuple(d for d in pairs if d.first is None or d.second is None or (d.first.value, d.first.unit) != (d.second.value, d.second.unit))
