"""The folder of a prediction: time histories, a figure, and the JSON last."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import PREDICTED, write_json
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.prediction.page import prediction_page
from scenarios.prediction.predict import Prediction, figures_of

MAIN = "prediction.json"
SCHEMA = "flightid/prediction/1"
DECLARED = "declared_"


def write_prediction(found: Prediction, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write ``prediction.csv``, the figure ``prediction``, and ``prediction.json`` last; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        (scratch / "prediction.csv").write_text(_table(found), encoding="utf-8", errors="backslashreplace", newline="\n")
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.prediction.figure import prediction_figures

            drawn = drawn_for_page(prediction_figures(found), scratch, figures)
        write_page(scratch, prediction_page(found, drawn))
        write_json(scratch / MAIN, prediction_content(found))
    return Path(folder)


def prediction_content(found: Prediction) -> dict[str, Any]:
    """Content of ``prediction.json``: errors in SI, nz in g; ``declared`` those of a diagnosis's model without the effects found."""
    kept, record = found.kept, found.record
    files = {"vehicle": kept.vehicle, "model": kept.own_file, "effects": kept.effects_file}
    return {
        "schema": SCHEMA,
        "study": found.study.name,
        "made_by": kept.made_by,
        "model": kept.model,
        "vehicle": found.vehicle,
        "effects": [effect.name for effect in kept.after.effects],
        "claimed": list(kept.claimed),
        "record": {"name": record.name, "samples": len(record), "from": float(record.time[0]), "to": float(record.time[-1])},
        "units": {name: record[name].unit for name in found.channels},
        "finite": found.after.figures is not None,
        "channels": figures_of(found.after),
        **({"declared": figures_of(found.before)} if found.before is not None else {}),
        "warnings": list(found.warnings),
        "notes": list(found.notes),
        "inputs": {
            "record": found.source.name,
            "record_sha256": found.source.sha256,
            **{key: value for name, file in files.items() if file is not None for key, value in ((name, file.name), (f"{name}_sha256", file.sha256))},
        },
        "versions": versions(),
    }


def _table(found: Prediction) -> str:
    """``time``, and of each channel ``NAME``, ``predicted_NAME`` and of a diagnosis ``declared_NAME``; a cell without a number is empty."""
    columns = {"time": found.record.time.tolist()}
    for i, name in enumerate(found.channels):
        columns[name] = found.record[name].with_gaps().tolist()
        columns[f"{PREDICTED}{name}"] = found.after.rows[i].tolist()
        if found.before is not None:
            columns[f"{DECLARED}{name}"] = found.before.rows[i].tolist()
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([repr(cell) if cell == cell else "" for cell in row] for row in zip(*columns.values(), strict=True))
    return text.getvalue()
