"""How far a diagnosis looks: what each effort sets, and what is said of it."""

from __future__ import annotations

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.settings import EFFORTS, NORMAL, TraceSettings
from sim.errors import DeclarationError


def settings_of(effort: str) -> TraceSettings:
    """The settings of the loop for an effort; DeclarationError, in one line, for one that there is
    not.
    """
    if effort not in EFFORTS:
        raise DeclarationError(
            f"there is no effort {effort!r}", where="--effort", remedy=f"use {' or '.join(EFFORTS)}"
        )
    return EFFORTS[effort]


def effort_sentence(effort: str, diagnosis: Diagnosis) -> str:
    """Which effort was made, and whether a greater one would look further: where a search used all
    its fits and the residual is not explained.
    """
    if not (diagnosis.stopped and diagnosis.verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)):
        return f"effort: {effort}"
    further = (
        "--effort thorough would look further"
        if effort == NORMAL.effort
        else "there is no greater effort"
    )
    return (
        f"effort: {effort}; the search used all its fits, and the residual is not explained: "
        f"{further}"
    )
