"""Which figures a diagnosis gets, and the part of it that they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity

# File stem and caption, in the order of the report; further records get a number behind the stem.
CAPTIONS = {
    "held_out": "Measured against predicted on data that were not fitted, and what each prediction leaves",
    "residuals": "Residuals of the fitted data with the declared model and with the effects",
    "evidence": "What each candidate would bring",
    "derivatives": "Derivatives with the declared model and with the effects",
    "spectra": "Spectra of the residuals over that of the noise",
}


@dataclass(frozen=True, eq=False)
class Pictured:
    """What the figures show of a diagnosis; ``noise`` by channel, ``claimed`` names of effects."""

    fitted: tuple[FittedRecord, ...]
    predictions: tuple[Prediction, ...]
    candidates: tuple[Candidate, ...]
    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    noise: Mapping[str, float]
    claimed: tuple[str, ...]
    held_out: bool


def draw_diagnosis(pictured: Pictured, folder: Path) -> None:
    """Draw all figures into ``folder`` as PNG files."""
    from scenarios.plots.diagnosis import figure_derivatives, figure_evidence, figure_held_out, figure_residuals, figure_spectra
    from scenarios.plots.files import save_figure

    kind = "held out" if pictured.held_out else "fitted"
    for number, prediction in enumerate(pictured.predictions):
        title = f"{prediction.record.name} ({kind}): measured and predicted"
        save_figure(figure_held_out(prediction, pictured.noise, title), folder, numbered("held_out", number))
    for number, fitted in enumerate(pictured.fitted):
        save_figure(figure_residuals(fitted, pictured.noise, f"{fitted.record.name}: residuals"), folder, numbered("residuals", number))
        save_figure(figure_spectra(fitted, pictured.noise, f"{fitted.record.name}: spectra of the residuals"), folder, numbered("spectra", number))
    if pictured.candidates:
        save_figure(figure_evidence(pictured.candidates, pictured.claimed, "Evidence"), folder, "evidence")
    if pictured.before:
        save_figure(figure_derivatives(pictured.before, pictured.after, "Derivatives"), folder, "derivatives")


def numbered(stem: str, number: int) -> str:
    """``residuals``, ``residuals_2``, ... for the records 0, 1, ..."""
    return stem if number == 0 else f"{stem}_{number + 1}"


def figure_stems(folder: Path) -> list[tuple[str, str]]:
    """Stems and captions of the figures in a folder, in the order of the report."""
    found = []
    for stem, caption in CAPTIONS.items():
        names = sorted((path.stem for path in folder.glob(f"{stem}*.png")), key=lambda name: (len(name), name))
        found += [(name, caption) for name in names]
    return found
