"""`flightid predict`: the model of a study on another record, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.plots.formats import Formats
from scenarios.prediction.predict import Asked, predict_record
from scenarios.prediction.words import prediction_text


def predict_with_study(asked: Asked, out: Path | None, figures: Formats) -> None:
    """Read, predict, write, print."""
    from scenarios.terminal.paragraphs import terminal_width
    from scenarios.terminal.summary import written_to

    found = predict_record(asked)
    if out is not None:
        from scenarios.prediction.files import write_prediction

        write_prediction(found, out, figures=figures)
    print(prediction_text(found, terminal_width()), end="")
    if out is not None:
        print(written_to(out))
