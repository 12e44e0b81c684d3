"""Figures of results: functions that take a result and return a matplotlib Figure.

- A record: ``record`` (inputs and outputs against time), ``maneuvers`` (found in a flight).
- An identification: ``fit`` and ``held_out`` (measured and predicted outputs), ``correlation`` (of
  the estimates).
- A diagnosis: ``residuals``, ``spectra`` (of the residuals), ``prediction`` (of a held-out record),
  ``evidence`` (the best candidates of each round), ``derivatives`` (of the declared model),
  ``replication`` (parameters of the effects, estimated from each record alone).
- Frequency responses: ``response`` (magnitude, phase, coherence), ``mismatch`` (over the fitted
  transfer function), ``bandwidth`` (with phase delay), ``qualities`` (criteria of flying qualities
  with their levels), ``step`` (step response), ``loop`` (broken-loop response with its margins).
- A compatibility check: ``reconstruction`` (of channels by kinematics).

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
