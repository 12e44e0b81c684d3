"""Checks a built site: `python -m docs._ext.check SITE`. Every link leads somewhere, and no page
asks another host for anything.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Tags and attributes by which a browser fetches something without being asked.
FETCHED = {
    ("script", "src"),
    ("img", "src"),
    ("iframe", "src"),
    ("source", "src"),
    ("video", "src"),
    ("link", "href"),
    ("object", "data"),
}
IMPORTED = re.compile(r"""(?:url\(|@import)\s*["']?\s*(https?:)?//""")


class Page(HTMLParser):
    """What a page links to, what it fetches, and the places in it that a link may name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if not value:
                continue
            if name == "id" or (tag == "a" and name == "name"):
                self.anchors.add(value)
            if (tag, name) in FETCHED:
                self.fetched.append(value)
            elif tag == "a" and name == "href":
                self.links.append(value)


@cache
def page(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def complaints(site: Path) -> Iterator[str]:
    """One sentence for each link that leads nowhere and each thing that is fetched from
    elsewhere.
    """
    # the theme's own templates lie there
    for path in sorted(each for each in site.rglob("*.html") if "_static" not in each.parts):
        name, here = path.relative_to(site), page(path)
        for address in here.fetched:
            if urlsplit(address).netloc:
                yield f"{name} fetches {address}"
        for address in [*here.links, *(each for each in here.fetched if not urlsplit(each).netloc)]:
            if wrong := leads_nowhere(path, address):
                yield f"{name}: {address}: {wrong}"
    for path in sorted(site.rglob("*.css")):
        if IMPORTED.search(path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(site)} fetches from another host"


def leads_nowhere(path: Path, address: str) -> str:
    """What is wrong with a link of a page, empty where nothing is or where it leads to another
    host.
    """
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        return ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if not target.is_file():
        return "there is no such file"
    if (
        parts.fragment
        and target.suffix == ".html"
        and unquote(parts.fragment) not in page(target).anchors
    ):
        return "there is no such place in it"
    return ""


def main() -> None:
    site = Path(sys.argv[1]).resolve()
    found = list(complaints(site))
    print("\n".join(found))
    if found or not (site / "index.html").is_file():
        sys.exit(f"{len(found)} faults in {site}")
    print(
        f"{page.cache_info().currsize} pages, every link leads somewhere, nothing is fetched from "
        "another host"
    )


if __name__ == "__main__":
    main()
