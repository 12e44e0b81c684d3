"""Lines of a terminal as sentences of a page."""

from __future__ import annotations


def sentence(text: str) -> str:
    """With a large first letter and an end."""
    return capital(text) + ("" if text.endswith((".", ":", "?", "!")) else ".")


def capital(text: str) -> str:
    """The first letter large, but for names of parameters, effects and files."""
    first = text.split(" ", 1)[0]
    return text if any(mark in first.rstrip(".:") for mark in "_.:-") else text[:1].upper() + text[1:]
