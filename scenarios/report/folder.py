"""The page in a study folder, its JSON, and pages made again from it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenarios.files.sources import MOST_DOCUMENT, found_json, json_value, read_content
from scenarios.files.writing import write_json, write_text
from scenarios.report.document import Figure, Page
from scenarios.report.figure_formats import Drawn
from scenarios.report.html import page_html
from scenarios.report.page_json import page_content, page_of
from scenarios.report.summary import PAGE
from sim.errors import FlightidError

CONTENT = "report.json"
_FURTHER = ("maneuvers.json",)
_DOCUMENTS = (
    "comparison.json",
    "diagnosis.json",
    "compatibility.json",
    "campaign.json",
    "compared.json",
    "design.json",
    "survey.json",
    "maneuvers.json",
    "responses.json",
)


def write_page(folder: Path, page: Page) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists."""
    write_json(folder / CONTENT, page_content(page))
    write_text(folder / PAGE, page_html(page))


def rebuilt(folder: str | Path) -> Path:
    """Make ``report.html`` again from ``report.json``, computing nothing; the page's path.

    Raises
    ------
    FlightidError : there is no such folder, no content of a page in it, or one that cannot be read.
    """
    folder = Path(folder)
    text = page_html(stored_page(folder))
    target = folder / PAGE
    try:
        write_text(target, text)
    except OSError as error:
        raise FlightidError(
            f"cannot be written ({error.strerror})",
            where=str(target),
            remedy="name a folder that you may write in",
        ) from None
    return target


def stored_page(folder: Path) -> Page:
    """The page that ``report.json`` of a folder describes.

    Raises
    ------
    FlightidError : there is no such folder, no content of a page in it, or one that cannot be read.
    """
    source = folder / CONTENT
    if not folder.is_dir():
        raise FlightidError(
            "there is no such folder",
            where=str(folder),
            remedy="name the folder of a study, what --out was given",
        )
    if not source.is_file():
        raise FlightidError(
            f"has no {CONTENT}: {_older(folder)}", where=str(folder), remedy=_again(folder)
        )
    content = read_content(source, FlightidError, "the folder of a study", MOST_DOCUMENT)
    try:
        return page_of(json_value(content))
    except (KeyError, TypeError, ValueError, AttributeError, FlightidError):
        raise FlightidError(
            "is no content of a page that this version can show",
            where=str(source),
            remedy=_again(folder),
        ) from None


def figures(drawn: Sequence[Drawn]) -> tuple[Figure, ...]:
    """Figures that were drawn, as blocks of a page."""
    return tuple(Figure(f"figure-{each.stem}", each.svg, each.caption, each.plot) for each in drawn)


def first_figure(drawn: Sequence[Drawn]) -> tuple[tuple[Figure, ...], tuple[Figure, ...]]:
    """The figure with which a page begins, inputs above outputs with their residuals, and the
    others; without the one of the record alone, which shows the same.
    """
    fit = [each for each in drawn if each.stem == "fit"]
    others = [each for each in drawn if each not in fit and not (fit and each.stem == "record")]
    return figures(fit), figures(others)


def _older(folder: Path) -> str:
    return "the study is of an older version" if _document(folder) else "it is no study folder"


def _again(folder: Path) -> str:
    """What to run, as far as the folder's own document tells."""
    document = _document(folder)
    name = document.get("scenario")
    if not document:
        return "name the folder that --out was given"
    if (
        document.get("schema") == "flightid/comparison/1"
        and isinstance(name, str)
        and "seed" in document
    ):
        return f"run it again: flightid run {name} --seed {document['seed']} --out {folder}"
    if isinstance(name, str) and "runs" in document:
        seed = document.get("seed", document.get("first_seed", 1))
        return (
            f"run it again: flightid campaign {name} --runs {document['runs']} --seed {seed} --out "
            f"{folder}"
        )
    return f"run its command again with --out {folder}"


def _document(folder: Path) -> dict[str, Any]:
    for name in _DOCUMENTS:
        content = found_json(folder / name)
        if isinstance(content, dict) and str(content.get("schema", "")).startswith("flightid/"):
            return content
    return {}
