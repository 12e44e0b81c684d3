"""The study folder of a scenario: record, truth, comparison, histories, figures."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.folders import study_folder
from scenarios.files.writing import RESPONSE, write_json, write_record, write_responses
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.studies.comparison import comparison
from scenarios.studies.determination.content import determination_csv
from scenarios.studies.report.page import study_page
from scenarios.studies.study import MethodResult, Study
from scenarios.studies.sweep.content import sweep_csv
from scenarios.studies.text import print_study
from scenarios.terminal.numbers import as_text
from scenarios.terminal.summary import HERE
from sim.truth.flight import TOLERANCE, Truth

MAIN = "comparison.json"


def write_study(study: Study, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a study into ``folder``, whole or not at all; returns the folder.

    Files: ``record.csv`` and ``record.json``, ``truth.json``, ``study.txt`` (what the terminal shows), ``response.csv`` (measured, predicted
    and noise-free outputs), ``history.csv`` of a filter, figures in the formats ``figures``, ``report.html`` with them and ``report.json``, from
    which it is made, ``comparison.json`` last. Further methods leave
    ``response_METHOD.csv`` and ``history_METHOD.csv``, those that saw another flight or other sensors ``record_METHOD.csv``; a sweep
    ``sweep.csv``, determination ``determination.csv``.
    """
    with study_folder(folder, MAIN) as scratch:
        write_record(scratch, study.record, simulated=True)
        for method in study.methods:
            name = method.estimation.name
            if method.result.record is not study.record:
                write_record(scratch, method.result.record, f"record_{name}", simulated=True)
            suffix = "" if method is study.main else f"_{name}"
            estimate = method.result.estimate
            predicted = dict(zip(estimate.output_names, estimate.fitted[0], strict=True))
            write_responses(scratch / f"{RESPONSE}{suffix}.csv", method.result.record, predicted, method.truth.outputs if method.truth else None)
            if estimate.history is not None:
                write_history(scratch / f"history{suffix}.csv", method)
        write_json(scratch / "truth.json", truth_content(study.truth))
        determined = [method.determination for method in study.methods if method.determination is not None]
        if determined:
            (scratch / "determination.csv").write_text(determination_csv(determined), encoding="utf-8", newline="\n")
        if study.sweep is not None:
            (scratch / "sweep.csv").write_text(sweep_csv(study.sweep), encoding="utf-8", newline="\n")
        (scratch / "study.txt").write_text(
            as_text(lambda out: print_study(study, out, HERE)), encoding="utf-8", errors="backslashreplace", newline="\n"
        )
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.studies.figures import study_figures

            drawn = drawn_for_page(study_figures(study), scratch, figures)
        write_page(scratch, study_page(study, drawn))
        write_json(scratch / MAIN, comparison(study))
    return Path(folder)


def truth_content(truth: Truth) -> dict[str, Any]:
    """True parameters, effects, noise and distance, without the histories."""
    return {
        "schema": "flightid/truth/1",
        "parameters": {item.name: {"value": item.value, "unit": item.unit, "source": item.source} for item in truth.parameters},
        "effects": list(truth.effects),
        "noise_std": dict(truth.noise_std),
        "process_density": dict(truth.process_density),
        "distance": truth.distance.value,
        **({"tolerance": TOLERANCE} if truth.step is None else {"step": truth.step}),
        "method": truth.method,
    }


def write_history(path: Path, method: MethodResult) -> None:
    """States and parameters after each sample with their standard deviations, and innovations, as CSV."""
    history = method.result.estimate.history
    assert history is not None
    outputs = method.result.estimate.output_names
    header = ["time"]
    for name in history.names:
        header += [name, f"std_{name}"]
    for name in outputs:
        header += [f"innovation_{name}", f"std_innovation_{name}"]
    columns = [history.time]
    for mean, std in zip(history.mean, history.std, strict=True):
        columns += [mean, std]
    for value, std in zip(history.innovation, history.innovation_std, strict=True):
        columns += [value, std]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([f"{value:.9g}" for value in row] for row in np.array(columns).T.tolist())
    path.write_text(text.getvalue(), encoding="utf-8", newline="\n")
