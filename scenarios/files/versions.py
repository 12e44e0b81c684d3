"""Versions of the packages that the numbers hang on."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("flightid", "numpy", "scipy", "filterpy", "control")


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
