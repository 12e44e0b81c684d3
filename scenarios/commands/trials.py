"""`flightid campaign` of the tracing loop itself: false alarms, clean records of every model, weak effects, papers drawn at random."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json
from scenarios.pages.folder import write_page
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import written_to
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.clean import CleanRun, clean_flight, clean_rows
from scenarios.trials.detection import SETTINGS, WEAK, Alarm, Detection, alarm_rows, clean_run, detection_rows, weak_run, weak_setting
from scenarios.trials.many import of_each_seed
from scenarios.trials.page import trials_page
from scenarios.trials.papers.examination import examine
from scenarios.trials.papers.paper import Mark
from scenarios.trials.papers.summary import summary
from scenarios.trials.stopping import flown, stopped_after
from sim.errors import DeclarationError

GAIN = 25.0  # expected gain of the log likelihood of a weak effect, from which nearly all are found
CLEAN = ("model", "runs", "false claims", "95 % interval, %", "not consistent", "within two sigmas, %", "sigma over bound", "median time, s")
DETECTED = ("runs", "detected", "named right", "among alternatives", "unexplained", "named wrong", "detected, 95 % interval, %")


@dataclass(frozen=True)
class Kind:
    """A campaign of the loop: what is done with one seed, and the table of all that was found (title, headings, rows)."""

    fly: Callable[[int], Any]
    tabled: Callable[[Sequence[Any]], tuple[str, tuple[str, ...], list[tuple[str, ...]]]]


def run_trials(name: str, runs: int, seed: int | None, out: Path | None, changes: Sequence[str], progress: bool = True) -> None:
    """Fly, diagnose and mark ``runs`` flights from ``seed`` on (None: 1), print the table, and write it as ``campaign.json`` into ``out``."""
    if changes:
        raise DeclarationError(f"nothing of {name} can be changed", where="--set", remedy="leave it out")
    first = 1 if seed is None else seed
    kind = TRIALS[name]
    seeds = range(first, first + runs)
    with progress_bar(progress) as tell:
        done = flown(lambda: of_each_seed(kind.fly, seeds, tell, os.cpu_count() or 1), seeds)
    title, headings, rows = kind.tabled(done.found)
    with stopped_after(len(done.seeds), runs, out):
        print("\n".join([f"{name}: {len(done.seeds)} flights, {done.words}", *table_lines(columns_of(headings, rows), title=title)]))
        if out is not None:
            content = {"schema": "flightid/campaign/1", "scenario": name, **done.content}
            with study_folder(out, "campaign.json") as scratch:
                tabled = [dict(zip(headings, row, strict=True)) for row in rows]
                write_page(scratch, trials_page(name, first, done.words, len(done.seeds), title, headings, rows))
                write_json(scratch / "campaign.json", {**content, "table": tabled, "versions": versions()})
            print(written_to(out))


def _clean(seed: int) -> tuple[str, Alarm]:
    setting = SETTINGS[seed % len(SETTINGS)]
    return setting.label, clean_run(setting, seed)


def _weak(seed: int) -> Detection:
    effect = tuple(WEAK)[seed % len(WEAK)]
    return weak_run(weak_setting(effect), effect, GAIN, seed)


def _alarms(found: Sequence[tuple[str, Alarm]]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    groups = {setting.label: [alarm for label, alarm in found if label == setting.label] for setting in SETTINGS}
    groups = {label: group for label, group in groups.items() if group} | {"all": [alarm for _, alarm in found]}
    headings = ("setting", "runs", "false claims", "not consistent", "95 % interval of false claims, %", "median time, s")
    return "clean records: nothing is hidden", headings, alarm_rows(groups)


def _of_models(found: Sequence[CleanRun]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    return "clean records: nothing is hidden; sigmas over the Cramer-Rao bound, median and 90 % of them", CLEAN, clean_rows(found)


def _detections(found: Sequence[Detection]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    rows = detection_rows(found, lambda each: each.effect) + detection_rows(found, lambda each: "all")
    return f"one weak effect, expected gain {GAIN:g}", ("effect", *DETECTED), rows


def _marks(found: Sequence[Mark]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    return "papers drawn at random", ("what is counted", "value"), [(what, f"{value:.4g}") for what, value in summary(found).items()]


TRIALS: Mapping[str, Kind] = {
    "false-alarms": Kind(_clean, _alarms),
    "clean-models": Kind(clean_flight, _of_models),
    "weak-effects": Kind(_weak, _detections),
    "random-papers": Kind(examine, _marks),
}
