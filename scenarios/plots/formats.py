"""In which formats figures are written; a format's name is the ending of its file. Nothing here loads the plotting library."""

from __future__ import annotations

from collections.abc import Sequence

from sim.errors import DeclarationError

Formats = tuple[str, ...]

PNG, SVG, PDF = "png", "svg", "pdf"
FORMATS: Formats = (PNG, SVG, PDF)
NONE = "none"
USUAL: Formats = (PNG,)


def formats_wanted(figures: bool | str | Sequence[str]) -> Formats:
    """The same from Python: True for the usual format, False for none, or names of formats. Raises DeclarationError as ``formats_of``."""
    if isinstance(figures, bool):
        return USUAL if figures else ()
    return formats_of([figures] if isinstance(figures, str) else list(figures) or [NONE])


def formats_of(asked: Sequence[str] | None, none: bool = False) -> Formats:
    """The formats that are asked for, in the order of ``FORMATS``: each text names one or several with commas between; None is ``USUAL``.

    ``none``, in the texts or as the second argument, asks for no figure. Raises DeclarationError for another name, for ``none`` beside
    a format and for no name at all.
    """
    names = [name.strip().lower() for text in asked or () for name in text.split(",")]
    remedy = f"name {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, several with commas between, or {NONE}"
    for name in names:
        if name not in (*FORMATS, NONE):
            raise DeclarationError(f"{name!r} is no format of a figure" if name else "no format is named", where="--figures", remedy=remedy)
    wanted = set(names) - {NONE}
    if wanted and (none or NONE in names):
        raise DeclarationError(f"no figures, and figures as {' and '.join(sorted(wanted))}", where="--figures", remedy="ask for one of the two")
    if none or NONE in names:
        return ()
    return tuple(name for name in FORMATS if name in wanted) if asked else USUAL
