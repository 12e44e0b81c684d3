"""Which figures a diagnosis gets, and their captions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.plots.formats import Drawn

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from scenarios.plots.display import Pictured
from scenarios.plots.formats import USUAL, Formats

# File stem and caption, in the order of the report; further records get a number behind the stem.
CAPTIONS = {
    "replication": (
        "Parameters of the effects from each record by itself and from the fitted records together"
    ),
    "held_out": (
        "Record against prediction on data that were not fitted, and what each prediction leaves"
    ),
    "residuals": "Residuals of the fitted data with the declared model and with the effects",
    "evidence": (
        "Log posterior odds of each candidate below those of the best, and why it was not chosen; "
        "open bars are linearised"
    ),
    "derivatives": "Derivatives with the declared model and with the effects",
    "spectra": "Spectra of the residuals over that of the noise",
}
DECLARED_CAPTIONS = {
    **CAPTIONS,
    "held_out": (
        "Record against what the declared model predicts of data that were not fitted, and what it "
        "leaves"
    ),
    "residuals": "Residuals of the fitted data with the declared model",
}  # where no effect stands beside it


def draw_diagnosis(pictured: Pictured, folder: Path, formats: Formats = USUAL) -> None:
    """Draw all figures into ``folder``, in every format and for the page."""
    from scenarios.plots.drawing import leave_for_page

    leave_for_page(figures_of(pictured), folder, formats)


def figures_of(pictured: Pictured) -> list[tuple[str, Callable[[], Figure]]]:
    """File stems of all figures, and what makes each."""
    from scenarios.plots.tracing import (
        figure_derivatives,
        figure_evidence,
        figure_held_out,
        figure_residuals,
        figure_spectra,
    )

    kind, noise = pictured.kind, pictured.noise
    out: list[tuple[str, Callable[[], Figure]]] = []
    for number, prediction in enumerate(pictured.predictions):
        title = f"{prediction.record.name} ({kind}): {pictured.data} and predicted"
        out.append(
            (
                numbered("held_out", number),
                partial(figure_held_out, prediction, noise, title, pictured.data),
            )
        )
    for number, fitted in enumerate(pictured.fitted):
        name = fitted.record.name
        out.append(
            (
                numbered("residuals", number),
                partial(figure_residuals, fitted, noise, f"{name}: residuals"),
            )
        )
        out.append(
            (
                numbered("spectra", number),
                partial(figure_spectra, fitted, noise, f"{name}: spectra of the residuals"),
            )
        )
    if pictured.candidates:
        out.append(
            (
                "evidence",
                partial(figure_evidence, pictured.candidates, pictured.standing, "Evidence"),
            )
        )
    if pictured.before and pictured.after:
        out.append(
            (
                "derivatives",
                partial(figure_derivatives, pictured.before, pictured.after, "Derivatives"),
            )
        )
    if pictured.replicated:
        from scenarios.plots.tracing import figure_replication

        out.append(
            (
                "replication",
                partial(figure_replication, pictured.replicated, "Parameters by record"),
            )
        )
    return out


def numbered(stem: str, number: int) -> str:
    """``residuals``, ``residuals_2``, ... for the records 0, 1, ..."""
    return stem if number == 0 else f"{stem}_{number + 1}"


def captioned(found: Mapping[str, str], *, declared: bool = False) -> tuple[Drawn, ...]:
    """Figures by stem in the order of the report, with their captions; ``declared``: they show the
    declared model alone.
    """
    out = []
    for stem, caption in (DECLARED_CAPTIONS if declared else CAPTIONS).items():
        names = sorted(
            (name for name in found if re.fullmatch(rf"{stem}(_\d+)?", name)),
            key=lambda name: (len(name), name),
        )
        out += [Drawn(name, found[name], caption) for name in names]
    return tuple(out)
