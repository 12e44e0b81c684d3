"""Arguments of users' functions: signals by name that cannot be changed, and a time that records whether it is used."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from sim.errors import FlightidError

NO_CHANGE = "make a new value, as in x = 2.0 * s.x instead of s.x *= 2.0 or x *= 2.0; signals that several functions need are formed in flow"


class ChangedArgument(FlightidError):
    """A user's function assigned to a signal that it was given."""

    def __init__(self, name: str) -> None:
        super().__init__(f"a function of a model or an effect assigns to the signal s.{name}", remedy=NO_CHANGE)


class Signals(SimpleNamespace):
    """Signals by name, as the attributes of the ``s`` of an equation.

    Attributes cannot be set or deleted. The library itself adds signals through ``__dict__``.
    """

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise ChangedArgument(name)

    def __delattr__(self, name: str) -> NoReturn:
        raise ChangedArgument(name)


def is_sampled(call: int) -> bool:
    """Whether the arrays of this call (counted from 0) are locked: calls 0, 1, 2, 4, 8 and so on.

    A view for each array of each call took 12 to 32 % of the time of an evaluation. A function that changes its arguments is found when it is
    declared (``sim.declaration.own_trial``), or at a later call where the change depends on values.
    """
    return not call & (call - 1)


def lock_arrays(signals: dict[str, Any]) -> None:
    """Replace each array of a mapping by a read-only view of it."""
    for name, value in signals.items():
        if type(value) is np.ndarray:
            signals[name] = locked(value)


def with_locked_arrays(parameters: Any) -> Any:
    """A named tuple with read-only views in place of its arrays; the same object where it holds none."""
    for value in parameters:
        if type(value) is np.ndarray:
            return parameters._make([locked(each) if type(each) is np.ndarray else each for each in parameters])
    return parameters


def locked(array: np.ndarray) -> np.ndarray:
    """A read-only view of an array."""
    view = array.view()
    view.setflags(write=False)
    return view


class WatchedTime(NDArrayOperatorsMixin):
    """Time zero that serves as a number or as an array without axes, and records in ``used`` whether anything was done with it.

    A function of the time is found by it even where its value changes at one instant only.
    """

    __array_priority__ = 1000.0

    def __init__(self) -> None:
        self.used = False

    def _value(self) -> np.ndarray:
        self.used = True
        return np.zeros(())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self._value().astype(dtype or float)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [each._value() if isinstance(each, WatchedTime) else each for each in inputs]
        return getattr(ufunc, method)(*plain, **options)

    def __float__(self) -> float:
        return float(self._value())

    def __complex__(self) -> complex:
        return complex(self._value())

    def __bool__(self) -> bool:
        return bool(self._value())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._value(), name)


def signals_from(values: Mapping[str, Any]) -> Signals:
    """Signals with read-only views in place of arrays."""
    found = Signals(**values)
    lock_arrays(found.__dict__)
    return found
