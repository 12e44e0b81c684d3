"""Which pages are made, and of which files of the checkout they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from docs._ext.made.api import modules_of, overview, package_page, packages, page_of
from docs._ext.made.commands import commands_page
from docs._ext.made.effects import effects_page
from docs._ext.made.gallery import gallery_page
from docs._ext.made.labs import lab_pages
from docs._ext.made.models import models_page, names_page
from docs._ext.made.python import python_pages
from docs._ext.made.scenarios import scenario_pages, scenarios_page
from docs._ext.made.vehicles import vehicles_page

# Pages from code, by name below `made`.
FROM_CODE: Mapping[str, Callable[[], str]] = {
    "commands": commands_page,
    "scenarios": scenarios_page,
    "effects": effects_page,
    "gallery": gallery_page,
    "models": models_page,
    "names": names_page,
    "vehicles": vehicles_page,
}
# Files outside `docs` that are pages as they stand.
COPIED = {
    "CHANGELOG.md": "changelog",
    "CONTRIBUTING.md": "contributing",
    "benchmarks/README.md": "benchmarks",
    "tests/README.md": "tests",
}


def copied(root: Path) -> Iterator[tuple[str, str]]:
    """File of the checkout and name of its page below ``made``."""
    yield from ((path, page) for path, page in COPIED.items() if (root / path).is_file())
    for path in sorted((root / "labs").glob("*.md")):
        yield path.relative_to(root).as_posix(), f"labs/{path.stem}"


def page_names(root: Path) -> dict[str, str]:
    """Path below the root -> page, for every file and folder that a link may name."""
    found = {"README.md": "index", "docs/README.md": "index"}
    for path in sorted((root / "docs").rglob("*.md")):
        name = path.relative_to(root / "docs").with_suffix("").as_posix()
        if not name.startswith(("made/", "_")) and name != "README":
            found[f"docs/{name}.md"] = name
            if path.stem == "README":
                found[f"docs/{name.rpartition('/')[0]}"] = name
    found |= {path: f"made/{page}" for path, page in copied(root)}
    found["labs"] = "made/labs/README"
    for folder in packages(root):
        page, place = f"made/{page_of(folder, root)}", folder.relative_to(root).as_posix()
        found |= {place: page, f"{place}/README.md": page}
        found |= {
            f"{place}/{module.name}": f"{page}#{module.name.replace('.', '')}"
            for module in modules_of(folder)
        }
    return found


def made_pages(root: Path, turn: Callable[[str, str, str], str]) -> dict[str, str]:
    """Every made page: name below ``docs`` -> Markdown.

    Parameters
    ----------
    root : of the checkout.
    turn : turns the links of a text that stands in a file for a page: ``turn(text, origin, page)``.
    """
    pages = {f"made/{name}": write() for name, write in FROM_CODE.items()}
    pages |= {f"made/{name}": text for name, text in scenario_pages().items()}
    pages |= {f"made/{name}": text for name, text in python_pages()}
    pages |= {f"made/{name}": text for name, text in lab_pages()}
    pages["made/api/README"] = overview(root)
    for path, page in copied(root):
        pages[f"made/{page}"] = turn(
            (root / path).read_text(encoding="utf-8"), path, f"made/{page}"
        )
    for folder in packages(root):
        readme, page = folder / "README.md", f"made/{page_of(folder, root)}"
        text = (
            turn(readme.read_text(encoding="utf-8"), readme.relative_to(root).as_posix(), page)
            if readme.is_file()
            else ""
        )
        pages[page] = package_page(folder, text, root)
    return pages
