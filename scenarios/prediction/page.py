"""The page of a prediction: how far a kept model is from a record that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.pages.folder import figures
from scenarios.pages.model import Bullets, Page, section
from scenarios.pages.printed import rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.prediction.predict import Prediction
from scenarios.prediction.words import HEADINGS, TITLE, error_rows, what_predicts


def prediction_page(found: Prediction, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a prediction with the figures ``drawn``."""
    record, figures_after = found.record, found.after.figures
    finite = figures_after is not None
    worst = min(figures_after.nrmse, key=lambda name: found.after.fit_percent(name), default="") if figures_after is not None else ""
    fits = f"worst of {len(found.channels)} channels: {worst}, {found.after.fit_percent(worst):.1f} % of it predicted" if worst else ""
    kept = (("vehicle", found.kept.vehicle), ("model", found.kept.own_file), ("effects", found.kept.effects_file))
    inputs = [("predicted", found.source.name, found.source.sha256), *((use, file.name, file.sha256) for use, file in kept if file is not None)]
    return Page(
        title=f"{record.name}: predicted",
        kind=what_predicts(found),
        verdict="" if finite else "no finite simulation",
        tone="plain" if finite else "open",
        sentence=sentence(fits) if fits else "",
        summary=(),
        warnings=tuple(map(sentence, found.warnings)),
        sections=(
            *section("Errors", rows_table(capital(TITLE), HEADINGS, error_rows(found))),
            *section("Figures", *figures(drawn)),
            *section("How it was made", Bullets(tuple(map(sentence, (_samples(found), *found.notes))))),
        ),
        reproduction=reproduction(["flightid", "predict", str(found.study), record.name], "", inputs),
        created=now(),
    )


def _samples(found: Prediction) -> str:
    record = found.record
    return f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s"
