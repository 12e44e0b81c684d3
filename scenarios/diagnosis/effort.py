"""How far a diagnosis looks: what each effort sets, and what is said of it."""

from __future__ import annotations

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.settings import EFFORTS, NORMAL, TraceSettings
from sim.errors import DeclarationError


def settings_of(effort: str) -> TraceSettings:
    """The settings of the loop for an effort; DeclarationError, in one line, for one that there is not."""
    if effort not in EFFORTS:
        raise DeclarationError(f"there is no effort {effort!r}", where="--effort", remedy=f"use {' or '.join(EFFORTS)}")
    return EFFORTS[effort]


def effort_sentence(effort: str, diagnosis: Diagnosis) -> str:
    """Which effort was made, and whether a greater one would look further: where the search ended at its means with something left."""
    if not (diagnosis.stopped and diagnosis.verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)):
        return f"effort: {effort}"
    further = "--effort thorough would look further" if effort == NORMAL.effort else "no greater effort is to be had"
    return f"effort: {effort}; the search ended at its means with something left: {further}"
