"""filterpy's extended Kalman filter, imported without the parts of filterpy that it does not use.

``import filterpy`` loads all of filterpy, and with it ``scipy.stats`` and ``scipy.ndimage``: half a second, of which the filter itself needs
a tenth. Two packages, ``filterpy.stats`` and ``filterpy.discrete_bayes``, are therefore left out while filterpy is imported; they are
imported when somebody asks for them.
"""

from __future__ import annotations

import importlib
import sys
import threading
from types import ModuleType
from typing import Any

_LEFT_OUT = ("filterpy.stats", "filterpy.discrete_bayes")
_LOCK = threading.Lock()


def extended_kalman_filter() -> Any:
    """``filterpy.kalman.ExtendedKalmanFilter``; filterpy is imported at the first call."""
    if "filterpy" not in sys.modules:
        with _LOCK:
            if "filterpy" not in sys.modules:
                _import_filterpy()
    from filterpy.kalman import ExtendedKalmanFilter

    return ExtendedKalmanFilter


def _import_filterpy() -> None:
    placeholders = {name: ModuleType(name) for name in _LEFT_OUT}
    # The only name that filterpy's filters take from what is left out; they call it for likelihoods alone.
    placeholders["filterpy.stats"].logpdf = _logpdf  # type: ignore[attr-defined]
    sys.modules.update(placeholders)
    try:
        filterpy = importlib.import_module("filterpy")
    finally:
        for name, module in placeholders.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]
    for name in _LEFT_OUT:
        vars(filterpy).pop(name.rpartition(".")[2], None)
    vars(filterpy)["__getattr__"] = _left_out


def _left_out(name: str) -> ModuleType:
    """Import a package of filterpy that was left out, when it is asked for as an attribute of filterpy."""
    if f"filterpy.{name}" not in _LEFT_OUT:
        raise AttributeError(f"module 'filterpy' has no attribute {name!r}")
    return importlib.import_module(f"filterpy.{name}")


def _logpdf(*arguments: Any, **keywords: Any) -> Any:
    from filterpy.stats import logpdf

    return logpdf(*arguments, **keywords)
