"""Figures of results: functions that take a result and return a matplotlib Figure."""

from __future__ import annotations

from scenarios.api.plot import (
    bandwidth,
    correlation,
    derivatives,
    evidence,
    fit,
    held_out,
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
    "bandwidth",
    "correlation",
    "derivatives",
    "evidence",
    "fit",
    "held_out",
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
