"""A user's own module `sim`, `ident` or `scenarios` that Python finds before the packages of these
names.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

ROOMS = ("sim", "ident", "scenarios")


def refuse_hidden(ours: str) -> None:
    """Raise ImportError, with the file that hides it, where a package beside the file ``ours``'s
    folder is not what Python would import.

    Nothing is imported for it.
    """
    home = Path(ours).resolve().parent.parent
    for room in ROOMS:
        found = _place_of(room)
        if found is not None and found.resolve() != home / room:
            shown = (
                found
                if found.is_dir()
                else found.with_suffix(".py")
                if found.with_suffix(".py").is_file()
                else found
            )
            remedy = (
                "rename it, or move it out of the folders that Python searches (sys.path), then "
                "start Python again"
            )
            # With the name `python -m flightid` tells it in one line.
            raise ImportError(
                f"{shown} hides the package {room!r} of flightid: {remedy}",
                name="flightid",
                path=str(shown),
            )


def _place_of(room: str) -> Path | None:
    """The folder of the package that the name leads to, or the file without its ending where it
    leads to a module; None where nowhere.
    """
    loaded = sys.modules.get(room)
    try:
        spec = loaded.__spec__ if loaded is not None else find_spec(room)
    except ValueError:  # a module without a spec, made by hand
        spec = None
    places = (
        list(getattr(loaded, "__path__", []))
        if loaded is not None
        else list(spec.submodule_search_locations or [])
        if spec is not None
        else []
    )
    if places:
        return Path(places[0])
    file = getattr(loaded, "__file__", None) or (spec.origin if spec is not None else None)
    return Path(file).with_suffix("") if file else None
