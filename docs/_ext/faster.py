"""Leaves out or shortens work of Sphinx whose result no page shows, a third of a build."""

from __future__ import annotations

import gc
import logging
import sys
from functools import lru_cache
from inspect import isclass, isfunction
from typing import Any

from sphinx.builders.latex.transforms import FootnoteDocnameUpdater
from sphinx.domains.c import AliasTransform as CAliases
from sphinx.domains.cpp import AliasTransform as CppAliases
from sphinx.ext.autodoc._dynamic import _signatures
from sphinx.pycode.parser import Parser
from sphinx.search.en import SearchEnglish
from sphinx.transforms import SphinxSmartQuotes
from sphinx.transforms.i18n import (
    AddTranslationClasses,
    RemoveTranslatableInline,
    TranslationProgressTotaliser,
)

# Each looks at every node of a page: for LaTeX, other languages and translations, of which there
# are none.
UNUSED = (
    CAliases,
    CppAliases,
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


def no_typehints(**_: object) -> None:
    """In place of a record of all annotations: signatures show them, descriptions do not."""


def skip_imported(
    app: Any, kind: str, name: str, member: Any, skip: bool, options: object
) -> bool | None:
    """Sphinx's hook: skip what a module imports. Sphinx skips it as well, but only after it has
    formatted its signature; of every two members it loads one in vain.
    """
    module = app.env.current_document.autodoc_module
    if kind != "module" or hasattr(sys.modules.get(module), "__all__"):
        return None
    imported = (isclass(member) or isfunction(member)) and member.__module__ != module
    return True if imported else None


class PageQuotes(SphinxSmartQuotes):
    """Typographic quotes on written pages; docstrings keep the quotes of their source."""

    def is_available(self) -> bool:
        """Whether the page gets typographic quotes."""
        return not self.env.docname.startswith("made/api/") and super().is_available()


def leave_out(app: Any) -> None:
    """Take away transforms and messages that no page shows; spare the collector what is loaded."""
    kept = [each for each in app.registry.transforms if each not in UNUSED]
    app.registry.transforms = [PageQuotes if each is SphinxSmartQuotes else each for each in kept]
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
    _signatures._record_typehints = no_typehints  # type: ignore[attr-defined]
    app.add_search_language(CachedEnglish)
    app.connect("autodoc-skip-member", skip_imported)
    app.connect("builder-inited", leave_out, priority=900)
    app.connect("env-before-read-docs", spread)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
