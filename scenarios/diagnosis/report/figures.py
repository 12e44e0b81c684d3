"""Figures of a diagnosis: the part of it that they show, which it gets, and their captions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.tracing.diagnosis import Prediction, Verdict
from scenarios.diagnosis.report.wording import as_declared, kind_of_predicted, record_labels
from scenarios.diagnosis.tracing import Tracing
from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    NamedEffects,
    Pictured,
    Replicated,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- The part of a diagnosis that its figures show

# what a number that has run away is written as: it reads back everywhere, and its square is finite
LARGEST = 1e30


def pictured(tracing: Tracing) -> Pictured:
    """The part of a diagnosis that figures show, its runaway numbers bounded."""
    d = as_declared(tracing.diagnosis)
    predictions = tuple(
        Prediction(p.record, p.channels, bounded_series(p.before), bounded_series(p.after))
        for p in d.predictions
    )
    claimed = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    standing = NamedEffects(
        tuple(claim.name for claim in claimed),
        {claim.name: claim.alternatives for claim in claimed if claim.alternatives},
        tuple(claim.name for claim in tracing.diagnosis.effects if not claim.claimed),
        d.verdict in (Verdict.CONSISTENT, Verdict.TRACED, Verdict.AMBIGUOUS),
    )
    shown = (
        predictions,
        d.candidates,
        d.before,
        d.after,
        d.noise_floor,
        standing,
        kind_of_predicted(d),
        _replicated(tracing),
    )
    return Pictured(d.fitted, *shown, SIMULATED_DATA if tracing.simulated else MEASURED_DATA)


def _replicated(tracing: Tracing) -> tuple[Replicated, ...]:
    labels = tuple(record_labels(tracing))
    told = [claim for claim in tracing.diagnosis.effects if claim.by_record]
    return tuple(
        Replicated(claim.name, labels[: len(claim.by_record)], claim.by_record, claim.parameters)
        for claim in told
    )


def bounded_series(values: np.ndarray) -> np.ndarray:
    """Finite numbers: a simulation that ran away is written as large as it needs to be seen."""
    return np.nan_to_num(np.clip(values, -LARGEST, LARGEST), nan=LARGEST)


# ---- Which figures a diagnosis gets

# File stem and caption, in the order of the report; further records get a number behind the stem.
CAPTIONS = {
    "replication": (
        "Parameters of the effects from each record by itself and from the fitted records together"
    ),
    "held_out": ("Recorded and predicted outputs of data that were not fitted, with the residuals"),
    "residuals": "Residuals of the fitted data with the declared model and with the effects",
    "evidence": (
        "Gain of each candidate as a bar, its log posterior odds, and why it was not chosen; "
        "open bars are linearised"
    ),
    "derivatives": "Derivatives with the declared model and with the effects",
    "spectra": (
        "Spectra of the residuals over that of the noise, and their coherence with the inputs"
    ),
}
DECLARED_CAPTIONS = {
    **CAPTIONS,
    "held_out": (
        "Outputs of data that were not fitted, recorded and predicted by the declared model, with "
        "the residuals"
    ),
    "residuals": "Residuals of the fitted data with the declared model",
}  # where no effect stands beside it


def draw_diagnosis(
    shown: Pictured, folder: Path, formats: Formats = USUAL, *, declared: bool = False
) -> tuple[Drawn, ...]:
    """Draw all figures, into ``folder`` in every format and for the page, in the order of the
    report; ``declared``: they show the declared model alone.
    """
    from scenarios.plots.drawing import drawn_for_page

    drawn = drawn_for_page(figures_of(shown), folder, formats)
    plots = {each.stem: each.plot for each in drawn}
    named = captioned({each.stem: each.svg for each in drawn}, declared=declared)
    return tuple(replace(each, plot=plots[each.stem]) for each in named)


def figures_of(pictured: Pictured) -> list[tuple[str, Callable[[], Figure]]]:
    """File stems of all figures, and what makes each."""
    from scenarios.plots.residuals import figure_held_out, figure_residuals, figure_spectra
    from scenarios.plots.tracing import figure_derivatives, figure_evidence

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
