"""How what a page shows is done again."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from scenarios.files.versions import versions
from scenarios.pages.model import Reproduction

PROGRAM = "flightid"
_PACKAGES = ("scenarios", PROGRAM)  # python -m


def reproduction(usual: Sequence[str], seed: str = "", inputs: Sequence[tuple[str, str, str]] = ()) -> Reproduction:
    """The command that was typed, or ``usual`` (its words) where none was; ``seed`` in a sentence; use, name and SHA-256 of each input."""
    return Reproduction((shlex.join(typed() or usual),), versions(), seed, tuple(inputs))


def typed() -> list[str]:
    """The words of this process's command line, beginning with the program's name; none where another program uses the library."""
    program, *words = sys.argv or [""]
    path = Path(program)
    ours = path.stem == PROGRAM or (path.name == "__main__.py" and path.parent.name in _PACKAGES)
    return [PROGRAM, *words] if ours and words else []


def now() -> str:
    """The time stamp of a page, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
