"""Figures of results: functions that take a result and return a matplotlib Figure.

``interactive`` makes a figure zoomable in a notebook.
"""

from __future__ import annotations

from scenarios.api.plot import (
    Interactive,
    bandwidth,
    correlation,
    derivatives,
    evidence,
    fit,
    held_out,
    interactive,
    loop,
    maneuvers,
    mismatch,
    prediction,
    qualities,
    reconstruction,
    record,
    replication,
    residuals,
    response,
    spectra,
    step,
)

__all__ = [
    "Interactive",
    "bandwidth",
    "correlation",
    "derivatives",
    "evidence",
    "fit",
    "held_out",
    "interactive",
    "loop",
    "maneuvers",
    "mismatch",
    "prediction",
    "qualities",
    "reconstruction",
    "record",
    "replication",
    "residuals",
    "response",
    "spectra",
    "step",
]


def __dir__() -> list[str]:
    return __all__
