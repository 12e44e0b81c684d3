"""`flightid --version`: this version, and those of what it computes with."""

from __future__ import annotations

from scenarios.files.versions import versions

NAMED = {"flightid": "flightid", "python": "Python", "numpy": "NumPy", "scipy": "SciPy"}


def show_version() -> None:
    """One line; a package that is not installed under its name is left out of it."""
    found = versions()
    print(", ".join(f"{word} {found[name]}" for name, word in NAMED.items() if name in found))
