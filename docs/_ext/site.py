"""The Sphinx extension of the site: made pages are written before sources are read; links and
contents are set as each is read.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from pygments.lexers.special import TextLexer

from docs._ext.links import turned
from docs._ext.made.pages import made_pages, page_names

ROOT = Path(__file__).resolve().parents[2]
FILES = frozenset(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "docs").rglob("*")
    if path.is_file() and path.suffix not in (".md", ".pyc") and "_ext" not in path.parts
)


def turn(text: str, origin: str, page: str) -> str:
    """A file's text with links of the site."""
    return turned(text, origin, page, page_names(ROOT), FILES)


def write_made_pages(app: Any) -> None:
    """Write what has changed and take away what is no longer made."""
    folder = Path(app.srcdir) / "made"
    pages = made_pages(ROOT, turn)
    for old in folder.rglob("*.md"):
        if old.relative_to(app.srcdir).with_suffix("").as_posix() not in pages:
            old.unlink()
    for name, text in pages.items():
        path = Path(app.srcdir) / f"{name}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def read(app: Any, name: str, source: list[str]) -> None:
    """Sphinx's hook for each page that is read: links as the site has them, contents as `conf.py`
    says.
    """
    text = source[0]
    if not name.startswith("made/"):
        text = turn(text, f"docs/{name}.md", name)
    below = contents_of(app, name)
    if below:
        listed = "\n".join(f"/{each}" for each in below)
        text += f"\n\n```{{toctree}}\n:hidden:\n:glob:\n:maxdepth: 2\n\n{listed}\n```\n"
    source[0] = text


def contents_of(app: Any, name: str) -> list[str]:
    """The pages below a page."""
    if name == "made/scenarios":
        return ["made/scenario/*"]
    if name == "made/api/README":
        return [
            f"made/api/{each}"
            for each in ("flightid", "scenarios", "ident", "sim")
            if (Path(app.srcdir) / f"made/api/{each}.md").is_file()
        ]
    if name == "made/contributing":
        return ["made/tests", "made/benchmarks"]
    return list(app.config.contents.get(name, ()))


def clean(app: Any, error: Exception | None) -> None:
    """An unfinished set of made pages is not left behind."""
    if error is not None:
        shutil.rmtree(Path(app.srcdir) / "made", ignore_errors=True)


def no_edit(app: Any, name: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Pages that are made from code have no file of their own to edit."""
    if name.startswith("made/") or not context.get("page_source_suffix"):
        context["theme_use_edit_page_button"] = False


def setup(app: Any) -> dict[str, object]:
    """Sphinx's hook of an extension."""
    app.add_lexer("csv", TextLexer)
    app.add_config_value("contents", {}, "env")
    app.connect("builder-inited", write_made_pages)
    app.connect("source-read", read)
    app.connect("html-page-context", no_edit)
    app.connect("build-finished", clean)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
