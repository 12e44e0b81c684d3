"""Whether a model predicts another record as well as it fits its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.tracing.diagnosis import ErrorFigures
from scenarios.kept import json_or_none

COLUMNS_NOTE = (
    "fit %: 100 where the error is zero, 0 where it is as large as the motion; Theil: 0 is "
    "perfect, 1 useless"
)
AS_WELL = 1.5  # largest ratio of the error to the residual of the fit that still agrees


@dataclass(frozen=True, eq=False)
class Simulation:
    """One free simulation of the record: ``rows`` ``(m, N)`` of its channels, and their errors;
    None if it left all measure.
    """

    rows: np.ndarray
    figures: ErrorFigures | None

    def fit_percent(self, channel: str) -> float:
        """100 (1 - rms error over the spread of the measurement)."""
        assert self.figures is not None
        return 100.0 * (1.0 - self.figures.nrmse[channel])


def residuals_of(study: Path) -> dict[str, tuple[float, float]]:
    """Return the residual of the fit of an ``identify`` and the sensor noise (both 1 sigma; the
    latter zero if unknown) by channel; empty if the folder keeps none.
    """
    content = json_or_none(study / "comparison.json")
    kept, noise = (
        found if isinstance(content, dict) and isinstance(found := content.get(key), dict) else {}
        for key in ("noise_std", "sensor_noise")
    )
    return {
        name: (float(value), float(noise.get(name) or 0.0))
        for name, value in kept.items()
        if isinstance(value, int | float) and value > 0.0
    }


def carried_over(simulation: Simulation, residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return a sentence that compares the errors with the residuals of the fit; empty if either is
    unknown.
    """
    errors = simulation.figures.rmse if simulation.figures is not None else {}
    ratios = {name: errors[name] / residuals[name][0] for name in errors if name in residuals}
    if not ratios:
        return ""
    worst = max(ratios, key=lambda name: ratios[name])
    size = f"the error is {'at most ' if len(ratios) > 1 else ''}{ratios[worst]:.2g} times"
    if ratios[worst] <= AS_WELL:
        return (
            f"{size} the residual of the fit ({worst}): the model predicts this record as well as "
            f"it fits its own{_lacking(residuals)}"
        )
    return (
        f"the error of {worst} is {ratios[worst]:.2g} times the residual of the fit: the model "
        "does not hold on this record"
    )


def _lacking(residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return what to add if the fit itself leaves more than the noise of the sensors."""
    ratios = {name: left / noise for name, (left, noise) in residuals.items() if noise > 0.0}
    worst = max(ratios, key=lambda name: ratios[name], default="")
    if not worst or ratios[worst] <= AS_WELL:
        return ""
    return (
        f"; but that fit leaves {ratios[worst]:.2g} times the sensor noise ({worst}): the model "
        "lacks something"
    )
