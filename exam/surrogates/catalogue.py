"""The surrogate flights that are declared here by name, and a user's own by the path of its
file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exam.surrogates.declaration import Surrogate
from exam.surrogates.schema import surrogate_of
from scenarios.files.declarations import closest
from scenarios.studies.catalogue import load_document
from sim.errors import DeclarationError

CATALOG = Path(__file__).parent / "catalog"
USUAL = "surrogate-one"


def surrogate_names() -> tuple[str, ...]:
    """Names of the declared surrogate flights, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_surrogate(name: str, changes: Sequence[str] = ()) -> Surrogate:
    """A surrogate flight by its name or the path of its TOML file, with ``"key=value"`` changes.

    Raises
    ------
    DeclarationError : there is none of that name, or a key or value in its file is wrong.
    """
    if not name.endswith(".toml") and name not in surrogate_names():
        remedy = closest(name, surrogate_names())
        raise DeclarationError(
            f"there is no surrogate flight {name!r}", where="exam", remedy=remedy
        )
    file = name if name.endswith(".toml") else str(CATALOG / f"{name}.toml")
    document, short, where = load_document(file, changes)
    return surrogate_of(document, short, where if file == name else f"{name}.toml")
