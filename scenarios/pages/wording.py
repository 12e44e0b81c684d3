"""Lines of a terminal as sentences of a page."""

from __future__ import annotations

from scenarios.terminal.summary import Summary


def sentence(text: str) -> str:
    """With a large first letter and an end."""
    return capital(text) + ("" if text.endswith((".", ":", "?", "!")) else ".")


def summary_sentences(summary: Summary) -> tuple[str, ...]:
    """What matters most and what the fit leaves, of the five lines that a terminal shows; study and outcome stand above them."""
    residual = f"residual: {summary.residual}" if summary.residual else ""
    return tuple(sentence(line) for line in (summary.result, residual) if line)


def capital(text: str) -> str:
    """The first letter large, but for names of parameters, effects and files."""
    first = text.split(" ", 1)[0]
    return text if any(mark in first.rstrip(".:") for mark in "_.:-") else text[:1].upper() + text[1:]
