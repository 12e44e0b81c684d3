"""Versions of what the numbers hang on."""

from __future__ import annotations

import contextlib
import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("flightid", "numpy", "scipy", "filterpy", "control")


def versions() -> dict[str, str]:
    """Python's version and those of the packages that are installed, the same in every file that a command writes."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def own_version() -> str:
    """The version of this package; ``"0+unknown"`` of a checkout that was never installed."""
    try:
        return version("flightid")
    except PackageNotFoundError:
        return "0+unknown"
