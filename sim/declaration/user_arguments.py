"""Arguments of a user's functions: signals and parameters with read-only arrays."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from sim.errors import ChangedArgument


class Signals(SimpleNamespace):
    """Argument ``s`` of a user's functions: its attributes are the signals by name.

    Attributes cannot be set or deleted. The library itself adds signals through ``__dict__``.
    """

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise ChangedArgument(name)

    def __delattr__(self, name: str) -> NoReturn:
        raise ChangedArgument(name)


def locks_arrays(call: int) -> bool:
    """Return whether a call locks the arrays that a user's function receives. ``call`` counts the
    calls from 0; calls 0, 1, 2, 4, 8 and so on lock.

    A locked array cannot be changed, so that a function that changes its arguments raises an error.
    Not every call locks, since this would cost 12 to 32 % of the time of an evaluation.
    """
    return not call & (call - 1)


def lock_arrays(signals: dict[str, Any]) -> None:
    """Replace each array of a mapping by a read-only view of it."""
    for name, value in signals.items():
        if type(value) is np.ndarray:
            signals[name] = locked(value)


def with_locked_arrays(parameters: Any) -> Any:
    """Return the named tuple with read-only views of its arrays; itself if it has no arrays."""
    for value in parameters:
        if type(value) is np.ndarray:
            return parameters._make(
                [locked(each) if type(each) is np.ndarray else each for each in parameters]
            )
    return parameters


def locked(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = array.view()
    view.setflags(write=False)
    return view


class WatchedTime(NDArrayOperatorsMixin):
    """Time zero that sets ``used`` to True when a function uses it as a number or an array.

    Comparing answers at several times would miss a function that changes at one instant only.
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
        values = [each._value() if isinstance(each, WatchedTime) else each for each in inputs]
        return getattr(ufunc, method)(*values, **options)

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
    """Return the signals ``values``, name -> value, with read-only views of arrays."""
    result = Signals(**values)
    lock_arrays(result.__dict__)
    return result
