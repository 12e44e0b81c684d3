"""Pictures of every kind of page on one sheet: ``python -m tests.browser.contact_sheet OUT``.

Each page is shown 1280 and 390 px wide and in print: printed by the browser, and by
``flightid report --pdf``. Pictures of single pages are kept beside the sheet. With ``--site
FOLDER`` kinds of pages of the documentation follow, at both widths and printed by the browser.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tests.browser.conftest import ARGUMENTS, DESKTOP, PHONE, executable
from tests.browser.every_page import COMMANDS, make_pages

if TYPE_CHECKING:
    from PIL.Image import Image
    from playwright.sync_api import Browser

SCALE = 0.4  # of the pictures on the sheet
TALLEST = 4000  # px of a strip of the sheet; what is taller continues in a strip beside it
GAP, HEAD = 24, 40  # px between pictures, above a row
PAPER = 60  # dots an inch
# Of the site, a page of each kind.
SITE = (
    *("index", "start", "made/gallery", "how-to/own-record", "tracing", "made/commands"),
    *("made/python/identify", "made/scenario/rigid", "made/labs/lab2", "made/api/ident.structure"),
)
# Figures are drawn as they come into sight.
SEEN = """async () => {
  for (let y = 0; y < document.documentElement.scrollHeight; y += 500) {
    scrollTo(0, y);
    await new Promise(done => setTimeout(done, 60));
  }
  scrollTo(0, 0);
}"""


def main(words: list[str] | None = None) -> None:
    """Make pages, pictures and the sheet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", type=Path, help="folder of the pictures; sheet.png is the sheet")
    parser.add_argument(
        "--only", nargs="*", choices=list(COMMANDS), help="kinds of pages; else all"
    )
    parser.add_argument("--site", type=Path, help="folder of the built documentation")
    asked = parser.parse_args(words)
    path = executable()
    if path is None or shutil.which("pdftoppm") is None:
        sys.exit("needs Chromium and pdftoppm (Debian: apt-get install chromium poppler-utils)")
    from playwright.sync_api import sync_playwright

    pages = make_pages(asked.out / "studies", tuple(asked.only or COMMANDS))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*ARGUMENTS])
        pictures = {
            kind: pictures_of(browser, page, asked.out / kind) for kind, page in pages.items()
        }
        if asked.site is not None:
            for name in SITE:
                stem = asked.out / f"site-{name.replace('/', '-')}"
                pictures[stem.name] = shots_of(browser, asked.site / f"{name}.html", stem)
        browser.close()
    sheet_of(pictures).save(asked.out / "sheet.png")
    print(f"{asked.out / 'sheet.png'}: {', '.join(pictures)}")


def pictures_of(browser: Browser, source: Path, stem: Path) -> list[Path]:
    """The page at both widths and on paper, as files whose names begin with ``stem``; printed by
    the command as well.
    """
    found = shots_of(browser, source, stem)
    command = [sys.executable, "-m", "flightid", "report", str(source.parent), "--pdf"]
    subprocess.run(command, check=True, capture_output=True)
    reported = stem.with_name(f"{stem.name}-report.pdf")
    (source.parent / "report.pdf").replace(reported)
    return [*found, rasterised(reported)]


def shots_of(browser: Browser, source: Path, stem: Path) -> list[Path]:
    """The page at both widths and as the browser prints it."""
    found = []
    for name, size in (("desktop", DESKTOP), ("phone", PHONE)):
        page = browser.new_page(viewport={"width": size["width"], "height": size["height"]})
        page.goto(source.as_uri())
        page.evaluate(SEEN)
        page.wait_for_timeout(300)
        found.append(stem.with_name(f"{stem.name}-{name}.png"))
        page.screenshot(path=str(found[-1]), full_page=True)
        page.close()
    page = browser.new_page()
    page.goto(source.as_uri())
    printed = stem.with_name(f"{stem.name}-print.pdf")
    page.pdf(path=str(printed), format="A4", print_background=True)
    page.close()
    return [*found, rasterised(printed)]


def rasterised(document: Path) -> Path:
    """The pages of a PDF one above the other, in one picture."""
    stem = document.with_suffix("")
    subprocess.run(["pdftoppm", "-r", str(PAPER), "-png", document, stem], check=True)
    sheets = sorted(stem.parent.glob(f"{stem.name}-[0-9]*.png"))
    picture = column([_opened(each) for each in sheets])
    for each in sheets:
        each.unlink()
    found = stem.with_suffix(".png")
    picture.save(found)
    return found


def column(pictures: list[Image]) -> Image:
    """Pictures one above the other on grey."""
    from PIL import Image

    whole = Image.new(
        "RGB",
        (max(each.width for each in pictures), sum(each.height + GAP for each in pictures)),
        "#888888",
    )
    at = 0
    for each in pictures:
        whole.paste(each, (0, at))
        at += each.height + GAP
    return whole


def strips(picture: Image) -> list[Image]:
    """The whole picture, cut into pieces that are at most ``TALLEST`` tall."""
    return [
        picture.crop((0, top, picture.width, min(picture.height, top + TALLEST)))
        for top in range(0, picture.height, TALLEST)
    ]


def sheet_of(pictures: dict[str, list[Path]]) -> Image:
    """A row for each kind of page, its name above: all its pictures, whole."""
    from PIL import Image, ImageDraw

    rows = []
    for kind, files in pictures.items():
        small = []
        for file in files:
            for shown in strips(_opened(file)):
                size = int(shown.width * SCALE), max(1, int(shown.height * SCALE))
                small.append(shown.resize(size))
        row = Image.new(
            "RGB",
            (
                sum(each.width + GAP for each in small),
                HEAD + max(each.height for each in small) + GAP,
            ),
            "#bbbbbb",
        )
        ImageDraw.Draw(row).text((8, 10), kind, fill="black", font_size=20)
        at = 0
        for each in small:
            row.paste(each, (at, HEAD))
            at += each.width + GAP
        rows.append(row)
    return column(rows)


def _opened(file: Path) -> Image:
    from PIL import Image

    with Image.open(file) as picture:
        return picture.convert("RGB")


if __name__ == "__main__":
    main()
