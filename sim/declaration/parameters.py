"""Parameters of a model: a number with its unit, prior, bounds and origin; immutable."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sim.errors import ModelError

AIRSPEEDS = ("airspeed", "reference_airspeed")  # what equations call the constant speed that they are declared for


@dataclass(frozen=True)
class Parameter:
    """One constant of a model.

    Attributes
    ----------
    name : unique within a model, e.g. ``"Cm_alpha"`` or ``"input-delay.delay"``.
    value : in the unit below; SI and radians throughout.
    unit : text, ``"1"`` when the number has none.
    prior_std : standard deviation of what is known beforehand, ``inf`` when nothing is.
    bounds : physical limits, inclusive.
    free : estimated (True) or held (False).
    source : where the number comes from.
    """

    name: str
    value: float
    unit: str = "1"
    prior_std: float = math.inf
    bounds: tuple[float, float] = (-math.inf, math.inf)
    free: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not math.isfinite(self.value):
            raise ModelError(f"value {self.value} is not a finite number", where=f"parameter {self.name}", remedy="give a finite value")
        if not low <= self.value <= high:
            raise ModelError(
                f"value {self.value:g} {self.unit} lies outside [{low:g}, {high:g}]",
                where=f"parameter {self.name}",
                remedy="give a value within the bounds",
            )
        if not self.prior_std > 0:
            raise ModelError(
                f"prior standard deviation {self.prior_std:g} is not positive",
                where=f"parameter {self.name}",
                remedy="give a positive one, or hold it",
            )


@dataclass(frozen=True)
class ParameterSet:
    """An ordered, immutable collection of parameters with unique names."""

    items: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        names = [item.name for item in self.items]
        for name in names:
            if names.count(name) > 1:
                raise ModelError("declared twice", where=f"parameter {name}", remedy="keep one of the two")

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __getitem__(self, name: str) -> Parameter:
        return self.items[self.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items)

    @property
    def free_names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items if item.free)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {item.name: place for place, item in enumerate(self.items)}

    def index(self, name: str) -> int:
        """Position of a parameter; an unknown name is an error that lists the known ones."""
        try:
            return self._places[name]
        except KeyError:
            raise ModelError("there is no such parameter", where=name, remedy=f"use one of {', '.join(self.names)}") from None

    def values(self, names: Iterable[str] | None = None) -> np.ndarray:
        """Values in order, shape ``(n,)``; of all parameters or of those named."""
        chosen = self.items if names is None else [self[name] for name in names]
        return np.array([item.value for item in chosen], dtype=float)

    def with_values(self, values: Mapping[str, float]) -> ParameterSet:
        """The same set with some values replaced."""
        return self._changed({name: {"value": float(value)} for name, value in values.items()})

    def with_prior(self, prior_std: Mapping[str, float]) -> ParameterSet:
        """The same set with some prior standard deviations replaced."""
        return self._changed({name: {"prior_std": float(value)} for name, value in prior_std.items()})

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> ParameterSet:
        """The same set with some bounds replaced."""
        return self._changed({name: {"bounds": (float(low), float(high))} for name, (low, high) in bounds.items()})

    def hold(self, names: Iterable[str]) -> ParameterSet:
        """The same set with the named parameters fixed at their values."""
        return self._changed({name: {"free": False} for name in names})

    def release(self, names: Iterable[str]) -> ParameterSet:
        """The same set with the named parameters estimated."""
        return self._changed({name: {"free": True} for name in names})

    def only_free(self, names: Iterable[str]) -> ParameterSet:
        """The same set with exactly the named parameters estimated."""
        wanted = set(names)
        for name in wanted:
            self.index(name)
        return ParameterSet(tuple(replace(item, free=item.name in wanted) for item in self.items))

    def joined(self, other: Iterable[Parameter]) -> ParameterSet:
        """This set followed by further parameters."""
        return ParameterSet(self.items + tuple(other))

    def _changed(self, changes: Mapping[str, Mapping[str, Any]]) -> ParameterSet:
        for name in changes:
            self.index(name)
        return ParameterSet(tuple(replace(item, **changes.get(item.name, {})) for item in self.items))
