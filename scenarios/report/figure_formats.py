"""Formats of figures, figures of a page, and their captions. It loads no plotting library."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.report.plot_data import PlotData

# ---- Formats of the files of a figure

Formats = tuple[str, ...]

PNG, SVG, PDF = "png", "svg", "pdf"
FORMATS: Formats = (PNG, SVG, PDF)
NONE = "none"  # requests no figure
USUAL: Formats = (PNG,)


def formats_wanted(figures: bool | str | Sequence[str]) -> Formats:
    """Return the formats that a Python call requests: True for the usual one, False for none, or
    names of formats. Raise DeclarationError as ``formats_of``.
    """
    if isinstance(figures, bool):
        return USUAL if figures else ()
    names = [figures] if isinstance(figures, str) else figures
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        remedy = f"give True, False, or names of formats: {', '.join(FORMATS)}"
        raise DeclarationError(f"{figures!r:.60} names no format", where="figures", remedy=remedy)
    return formats_of([*names] or [NONE])


def formats_of(texts: Sequence[str] | None, none: bool = False) -> Formats:
    """Return the requested formats, in the order of ``FORMATS``.

    Parameters
    ----------
    texts : each names one or several formats, separated by commas, or ``NONE``; None requests the
        usual format.
    none : request no figure.

    Raises
    ------
    DeclarationError : a name is unknown or empty, or both a format and no figure are requested.
    """
    names = [name.strip().lower() for text in texts or () for name in text.split(",")]
    remedy = (
        f"name {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, several with commas between, or {NONE}"
    )
    for name in names:
        if name not in (*FORMATS, NONE):
            raise DeclarationError(
                f"{name!r} is no format of a figure" if name else "no format is named",
                where="--figures",
                remedy=remedy,
            )
    none = none or NONE in names
    requested = set(names) - {NONE}
    if requested and none:
        raise DeclarationError(
            f"no figures, and figures as {' and '.join(sorted(requested))}",
            where="--figures",
            remedy="ask for one of the two",
        )
    if none:
        return ()
    return tuple(name for name in FORMATS if name in requested) if texts else USUAL


# ---- Figures of a page


@dataclass(frozen=True)
class Drawn:
    """A figure of a page.

    Attributes
    ----------
    stem : stem of its files.
    svg : SVG element.
    caption : caption.
    plot : data of an interactive figure; None if it is not interactive.
    """

    stem: str
    svg: str
    caption: str
    plot: PlotData | None = field(default=None, compare=False)


# ---- Captions

# File stem -> caption.
CAPTIONS: Mapping[str, str] = MappingProxyType(
    tomllib.loads(Path(__file__).with_name("captions.toml").read_text(encoding="utf-8"))
)


def caption_of(stem: str, methods: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the caption of a figure by its file stem: ``fit``, ``fit_2`` or ``fit_METHOD``.

    The number of a record or the label of a method, from ``methods``, is added in brackets. An
    unknown stem is returned in words.
    """
    matching = [name for name in CAPTIONS if stem == name or stem.startswith(f"{name}_")]
    if not matching:
        words = stem.replace("_", " ")
        return words[:1].upper() + words[1:]
    name = max(matching, key=len)
    suffix = stem[len(name) + 1 :]
    if not suffix:
        return CAPTIONS[name]
    label = methods.get(suffix, suffix.replace("_", " "))
    if re.fullmatch(r"[0-9]+", label):
        label = f"record {label}"
    return f"{CAPTIONS[name]} ({label})"
