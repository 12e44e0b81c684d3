"""Leaves out or shortens work of Sphinx whose result no page shows, a third of a build."""

from __future__ import annotations

import gc
import logging
from functools import lru_cache
from typing import Any

from sphinx.builders.latex.transforms import FootnoteDocnameUpdater
from sphinx.pycode.parser import Parser
from sphinx.search.en import SearchEnglish
from sphinx.transforms.i18n import (
    AddTranslationClasses,
    RemoveTranslatableInline,
    TranslationProgressTotaliser,
)

# Each looks at every node of a page: for LaTeX, and for translations, which there are none of.
UNUSED = (
    FootnoteDocnameUpdater,
    AddTranslationClasses,
    RemoveTranslatableInline,
    TranslationProgressTotaliser,
)
# Trees of pages hold some ten million objects; the usual threshold searches them a thousand times.
OBJECTS_BETWEEN_COLLECTIONS = 200_000
PIECES = 8


class CachedEnglish(SearchEnglish):
    """The words of the search index; each word's stem is found once and not once a page."""

    def __init__(self, options: dict[str, str]) -> None:
        super().__init__(options)
        self._cached = lru_cache(maxsize=None)(super().stem)

    def stem(self, word: str) -> str:
        """The stem of a word, as the parent class finds it."""
        return self._cached(word)


def no_lines(parser: Parser) -> None:
    """In place of the search for the lines of each definition: only pages with source code need
    them.
    """


def leave_out(app: Any) -> None:
    """Take away transforms and messages that no page shows; spare the collector what is loaded."""
    app.registry.transforms = [each for each in app.registry.transforms if each not in UNUSED]
    if app.verbosity == 0:
        logging.getLogger("sphinx").setLevel(logging.INFO)
    gc.freeze()


def spread(app: Any, env: Any, names: list[str]) -> None:
    """Deal the pages out like cards: those of the API take longest, and Sphinx cuts the list into
    about eight pieces for its processes.
    """
    names[:] = [each for first in range(PIECES) for each in names[first::PIECES]]


def setup(app: Any) -> dict[str, object]:
    """Sphinx's hook of an extension."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS, 20, 100)
    Parser.parse_definition = no_lines  # type: ignore[method-assign, assignment]
    app.add_search_language(CachedEnglish)
    app.connect("builder-inited", leave_out, priority=900)
    app.connect("env-before-read-docs", spread)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
