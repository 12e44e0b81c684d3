"""`flightid campaign` of the tracing loop itself: false alarms, clean records of every model, weak effects, papers drawn at random."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json
from scenarios.pages.folder import write_page
from scenarios.tasks.manner import Manner, stopped
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import written_to
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.clean import MODELS, CleanRun, clean_flight, clean_rows
from scenarios.trials.detection import SETTINGS, WEAK, Alarm, Detection, alarm_rows, clean_run, detection_rows, weak_run, weak_setting
from scenarios.trials.page import trials_page
from scenarios.trials.papers.examination import examine
from scenarios.trials.papers.paper import Mark
from scenarios.trials.papers.summary import summary
from scenarios.trials.repeated import LoopFlights, fly_all
from sim.errors import DeclarationError

GAIN = 25.0  # expected gain of the log likelihood of a weak effect, from which nearly all are found
CLEAN = ("model", "runs", "false claims", "95 % interval, %", "not consistent", "within two sigmas, %", "sigma over bound", "median time, s")
DETECTED = ("runs", "detected", "named right", "among alternatives", "unexplained", "named wrong", "detected, 95 % interval, %")


@dataclass(frozen=True)
class Kind:
    """A campaign of the loop: what is done with one flight's number and seed, the dataclass that gives, and the table of all (title, headings,
    rows)."""

    fly: Callable[[int, int], Any]
    kind: Any
    tabled: Callable[[Sequence[Any]], tuple[str, tuple[str, ...], list[tuple[str, ...]]]]


def run_trials(name: str, runs: int, seed: int | None, manner: Manner, changes: Sequence[str], progress: bool = True) -> None:
    """Fly, diagnose and mark ``runs`` flights (``seed`` None: 1), print the table, and write it as ``campaign.json`` into ``manner.out``."""
    if changes:
        raise DeclarationError(f"nothing of {name} can be changed", where="--set", remedy="leave it out")
    root, out = 1 if seed is None else seed, manner.out
    kind = TRIALS[name]
    with progress_bar(progress) as tell:
        done = fly_all(LoopFlights(name, kind.fly, kind.kind, {}), runs, root, manner, tell)
    title, headings, rows = kind.tabled(done.found)
    print("\n".join([f"{name}: {done.ended} flights, {done.words}", *table_lines(columns_of(headings, rows), title=title)]))
    if out is not None:
        content = {"schema": "flightid/campaign/1", "scenario": name, **done.content}
        with study_folder(out, "campaign.json") as scratch:
            tabled = [dict(zip(headings, row, strict=True)) for row in rows]
            write_page(scratch, trials_page(name, done, title, headings, rows))
            write_json(scratch / "campaign.json", {**content, "table": tabled, "versions": versions()})
        print(written_to(out))
    if not done.whole:
        raise stopped(done.ended, done.asked, "flights", out)


def _clean(number: int, seed: int) -> Alarm:
    return clean_run(SETTINGS[number % len(SETTINGS)], seed)


def _weak(number: int, seed: int) -> Detection:
    effect = tuple(WEAK)[number % len(WEAK)]
    return weak_run(weak_setting(effect), effect, GAIN, seed)


def _alarms(found: Sequence[Alarm]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    groups = {setting.label: [each for each in found if each.setting == setting.label] for setting in SETTINGS}
    groups = {label: group for label, group in groups.items() if group} | {"all": [*found]}
    headings = ("setting", "runs", "false claims", "not consistent", "95 % interval of false claims, %", "median time, s")
    return "clean records: nothing is hidden", headings, alarm_rows(groups)


def _of_models(found: Sequence[CleanRun]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    return "clean records: nothing is hidden; sigmas over the Cramer-Rao bound, median and 90 % of them", CLEAN, clean_rows(found)


def _detections(found: Sequence[Detection]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    rows = detection_rows(found, lambda each: each.effect) + detection_rows(found, lambda each: "all")
    return f"one weak effect, expected gain {GAIN:g}", ("effect", *DETECTED), rows


def _marks(found: Sequence[Mark]) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
    return "papers drawn at random", ("what is counted", "value"), [(what, f"{value:.4g}") for what, value in summary(found).items()]


def _of_model(number: int, seed: int) -> CleanRun:
    return clean_flight(seed, MODELS[number % len(MODELS)])


def _examined(number: int, seed: int) -> Mark:
    return examine(seed)


TRIALS: Mapping[str, Kind] = {
    "false-alarms": Kind(_clean, Alarm, _alarms),
    "clean-models": Kind(_of_model, CleanRun, _of_models),
    "weak-effects": Kind(_weak, Detection, _detections),
    "random-papers": Kind(_examined, Mark, _marks),
}
