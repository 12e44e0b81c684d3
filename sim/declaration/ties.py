"""Ties: parameters that are no unknowns of their own, but a linear function of others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sim.declaration.parameters import ParameterSet
from sim.errors import ModelError


@dataclass(frozen=True)
class Tie:
    """``name`` = ``constant`` + the sum of factor times parameter over ``terms``, all in SI."""

    name: str
    terms: tuple[tuple[str, float], ...]
    constant: float = 0.0

    def of(self, values: Callable[[str], Any]) -> Any:
        """What the tie gives where ``values`` says what each parameter is."""
        out: Any = self.constant
        for source, factor in self.terms:
            out = out + factor * values(source)
        return out

    @property
    def sources(self) -> tuple[str, ...]:
        """The parameters that it follows."""
        return tuple(source for source, _ in self.terms)

    @property
    def words(self) -> str:
        """``"Cn_da = -0.1 Cl_da + 0.002"``."""
        parts = [f"{factor:g} {source}" for source, factor in self.terms] + ([f"{self.constant:g}"] if self.constant else [])
        return f"{self.name} = {' + '.join(parts)}".replace("+ -", "- ")


def with_tied_values(parameters: ParameterSet, ties: Sequence[Tie]) -> ParameterSet:
    """The set with each tied parameter held at what its tie gives.

    Raises
    ------
    ModelError : a tie of or to a parameter that there is not, of one that is tied already, to one that is tied itself, or a value that is
        not finite or beyond the tied parameter's bounds.
    """
    tied = [tie.name for tie in ties]
    for tie in ties:
        where = f"tie of {tie.name}"
        for name in (tie.name, *tie.sources):
            parameters.index(name)
        if tied.count(tie.name) > 1:
            raise ModelError("tied twice", where=where, remedy="keep one of the two")
        for source in tie.sources:
            if source in tied:
                raise ModelError(f"{source} is tied itself", where=where, remedy="tie both to parameters that are not")
        if not tie.terms or not all(math.isfinite(number) for number in (tie.constant, *(factor for _, factor in tie.terms))):
            raise ModelError("no finite numbers", where=where, remedy="give one parameter at least, with a finite factor")
    given = {tie.name: float(tie.of(lambda name: parameters[name].value)) for tie in ties}
    return parameters.hold(tied).with_values(given)
