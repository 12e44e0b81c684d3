"""The study folder of a closed-loop scenario: record, truth, comparison, history, figures."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.folders import study_folder
from scenarios.files.writing import write_json, write_record
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.terminal.numbers import as_text
from scenarios.terminal.summary import HERE
from scenarios.x29.content import loop_comparison
from scenarios.x29.printing import print_loop
from scenarios.x29.report.page import loop_page
from scenarios.x29.study import LoopStudy
from sim.closed_loop.airframe import X29
from sim.record import Record

MAIN = "comparison.json"


def write_loop(study: LoopStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a study into ``folder``, whole or not at all; returns the folder.

    Files: ``record.csv`` and ``record.json`` (the flight), ``truth.json``, ``study.txt`` (what the terminal shows), ``history.csv`` of the
    filter at the refined delay, ``simulation.csv`` (measured and freely simulated outputs in the window), figures, the page, ``comparison.json``
    last. Other scenarios that the study used are named in it, not nested.
    """
    with study_folder(folder, MAIN) as scratch:
        write_record(scratch, study.result.flown.record, simulated=True)
        write_json(scratch / "truth.json", truth_content(study))
        (scratch / "study.txt").write_text(
            as_text(lambda out: print_loop(study, out, HERE)), encoding="utf-8", errors="backslashreplace", newline="\n"
        )
        _write_history(scratch / "history.csv", study)
        _write_simulation(scratch / "simulation.csv", study.result.setting.record, study.simulated)
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.x29.figures import loop_figures

            drawn = drawn_for_page(loop_figures(study), scratch, figures)
        write_page(scratch, loop_page(study, drawn))
        write_json(scratch / MAIN, loop_comparison(study))
    return Path(folder)


def truth_content(study: LoopStudy) -> dict[str, Any]:
    """What was flown: airframe, stick, noise. No parameter of the low-order model is true for a loop of higher order."""
    flown, flight = study.result.flown, study.scenario.flight
    x29: X29 = flown.x29
    a, stick, t = x29.airframe, x29.stick, x29.telemetry
    content: dict[str, Any] = {
        "schema": "flightid/truth/1",
        "parameters": {},
        "airframe": {"name": x29.name, "title": a.title, "L_alpha": a.L_alpha, "L_q": a.L_q, "M_alpha": a.M_alpha, "M_q": a.M_q},
        "stick": {"kind": flight.stick.kind, "dead_band": stick.dead_band, "gain": stick.gain, "curvature": stick.curvature},
        "noise_std": {"alpha": t.alpha_noise, "q": t.q_noise, "nz": t.nz_noise} if flight.noise else {"alpha": 0.0, "q": 0.0, "nz": 0.0},
        "effects": [],
        "distance": study.scenario.distance,
    }
    if flight.spike is not None:
        content["effects"] = ["sensor-spikes:stick"]
        content["spike"] = {"time": flight.spike.time, "size": flight.spike.size}
    if flown.truth is not None:
        content["limits_met"] = {
            "command": float(np.mean(flown.truth.command_limited)),
            "rate": float(np.mean(flown.truth.rate_limited)),
            "stops": float(np.mean(flown.truth.stopped)),
        }
    return content


def _write_history(path: Path, study: LoopStudy) -> None:
    history, outputs = study.result.estimate.history, study.result.estimate.output_names
    assert history is not None
    columns: dict[str, np.ndarray] = {"time": history.time}
    for name, mean, std in zip(history.names, history.mean, history.std, strict=True):
        columns |= {name: mean, f"std_{name}": std}
    for name, value, std in zip(outputs, history.innovation, history.innovation_std, strict=True):
        columns |= {f"innovation_{name}": value, f"std_innovation_{name}": std}
    _write_columns(path, columns)


def _write_simulation(path: Path, record: Record, simulated: np.ndarray) -> None:
    columns: dict[str, np.ndarray] = {"time": record.time}
    for name, row in zip(("alpha", "q", "nz"), simulated, strict=True):
        columns |= {name: record[name].values, f"simulated_{name}": row}
    _write_columns(path, columns)


def _write_columns(path: Path, columns: dict[str, np.ndarray]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([f"{value:.9g}" for value in row] for row in np.array(list(columns.values())).T.tolist())
    path.write_text(text.getvalue(), encoding="utf-8", newline="\n")
