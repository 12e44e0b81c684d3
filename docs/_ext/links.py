"""Links of a code host turned into links of the site.

The pages point to files of the checkout, so that they can be followed where the code is hosted. On
the site a Markdown file is a page, a folder the page of its README, a Python file its part of the
API page; what the site does not have is shown without a link.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping

FENCED = re.compile(r"(^```.*?^```\s*?$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)\s]+)\)")


def turned(
    text: str, origin: str, page: str, pages: Mapping[str, str], files: frozenset[str]
) -> str:
    """Markdown with its links turned.

    Parameters
    ----------
    text : the Markdown as the checkout has it.
    origin : path of the file below the root of the checkout, ``"docs/how-to/watch.md"``.
    page : name of its page, ``"how-to/watch"``.
    pages : path of a file or folder -> page, with ``#anchor`` where it is a part of one.
    files : paths below ``docs`` that are no pages: pictures and files to take away.
    """

    def one(found: re.Match[str]) -> str:
        mark, words, target = found.groups()
        path, _, anchor = target.partition("#")
        if "://" in target or not path or target.startswith("mailto:"):
            return found[0]
        where = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
        if where in files:
            return f"{mark}[{words}]({posixpath.relpath(where, posixpath.join('docs', posixpath.dirname(page)))})"  # noqa: E501
        if where not in pages:
            return words
        name, _, part = pages[where].partition("#")
        to = posixpath.relpath(name, posixpath.dirname(page) or ".") + ".md"
        anchor = anchor or part
        return f"{mark}[{words}]({to}{'#' if anchor else ''}{anchor})"

    return "".join(
        each if each.startswith("```") else LINK.sub(one, each) for each in FENCED.split(text)
    )
