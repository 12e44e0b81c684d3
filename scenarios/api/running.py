"""Scenarios of every kind, each run, written and told in its own way; flown for their record alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from scenarios.files.declarations import named_after
from scenarios.plots.formats import Formats
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from rich.console import Console

    from sim.record import Record

Progress = Callable[[str, float], None]
KEPT = "below; save(FOLDER) keeps them"  # where more is to be read than a summary says, in Python


class Write(Protocol):
    """Writes a study into a folder, whole or not at all."""

    def __call__(self, study: Any, folder: Path, /, *, figures: Formats) -> object: ...


@dataclass(frozen=True)
class Runner:
    """A scenario that is loaded: how it is run with a seed (None: its own), written into a folder with figures of some formats, and printed.

    ``show`` prints a study, which says where else its details are. ``text``: what is printed where the output is no terminal, for Python.
    ``counted``: the share done that it tells is a measure of its time, as that of a search is not.
    """

    run: Callable[[int | None, Progress], Any]
    write: Write
    show: Callable[[Any, str], None]
    text: Callable[[Any], str]
    counted: bool = True


def untold(stage: str, share: float) -> None:
    """Progress that nobody asked for."""


def _identification(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.comparison import check_display
    from scenarios.studies.files import write_study
    from scenarios.studies.repeated import fly_repeatedly
    from scenarios.studies.study import Study, run_scenario
    from scenarios.studies.sweep.sweep import sweep_flexibility
    from scenarios.studies.text import print_study

    scenario = load_scenario(name, changes)

    def run(seed: int | None, progress: Progress) -> Study:
        study = run_scenario(scenario, seed)
        check_display(study)
        sweep = sweep_flexibility(scenario, study.record, study.seed, progress)
        return replace(study, repeated=fly_repeatedly(scenario, seed, progress), sweep=sweep)

    return Runner(run, write_study, _on_console(print_study), _as_text(print_study))


def _trace(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted.files import write_trace
    from scenarios.trials.planted.schema import trace_scenario_of
    from scenarios.trials.planted.study import run_trace
    from scenarios.trials.planted.text import trace_text

    run = partial(run_trace, trace_scenario_of(*load_document(name, changes)))
    return Runner(run, write_trace, _printed(trace_text), partial(trace_text, details=KEPT), counted=False)


def _loop(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.x29.files import write_loop
    from scenarios.x29.printing import print_loop
    from scenarios.x29.study import loop_scenario, run_loop

    scenario = loop_scenario(name, changes)
    return Runner(lambda seed, progress: run_loop(scenario, seed), write_loop, _on_console(print_loop), _as_text(print_loop))


def _sweep(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.sweeps.declaration import sweep_scenario_of
    from scenarios.trials.sweeps.study import print_sweep, run_sweep, write_sweep

    run = partial(run_sweep, sweep_scenario_of(*load_document(name, changes)))
    return Runner(run, write_sweep, _on_console(print_sweep), _as_text(print_sweep))


def _flown_only(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import scenario_file

    remedy = f"use flightid simulate {name} --out flight.csv, and then identify or diagnose"
    raise DeclarationError("a flight by JSBSim is a record without a study", where=scenario_file(name), remedy=remedy)


def _as_text(show: Callable[[Any, Console, str], None]) -> Callable[[Any], str]:
    """A study's text where it is shown on a console."""

    def text(study: Any) -> str:
        from scenarios.terminal.numbers import as_text

        return as_text(lambda out: show(study, out, KEPT))

    return text


def _on_console(show: Callable[..., None]) -> Callable[[Any, str], None]:
    """Prints a study with rich, and where its details are."""
    return lambda study, details: show(study, details=details)


def _printed(text: Callable[[Any, int, str], str]) -> Callable[[Any, str], None]:
    """Prints a study's text as wide as the terminal is."""

    def show(study: Any, details: str) -> None:
        from scenarios.terminal.paragraphs import terminal_width

        print(text(study, terminal_width(), details), end="")

    return show


LOADERS: Mapping[str, Callable[[str, Sequence[str]], Runner]] = {
    "identification": _identification,
    "trace": _trace,
    "x29": _loop,
    "sweep": _sweep,
    "jsbsim": _flown_only,
}


def flown_record(name: str, seed: int | None, changes: Sequence[str]) -> Record:
    """The record of a scenario that is flown once, by estimators or in closed loop."""
    from scenarios.studies.catalogue import load_scenario, scenario_file, scenario_kind

    if scenario_kind(name) == "sweep":
        import numpy as np

        from scenarios.studies.catalogue import load_document
        from scenarios.trials.sweeps.declaration import sweep_scenario_of
        from scenarios.trials.sweeps.flight import fly_sweep

        sweep = sweep_scenario_of(*load_document(name, changes))
        with named_after(scenario_file(name)):
            return fly_sweep(sweep, np.random.default_rng(sweep.seed if seed is None else seed))
    if scenario_kind(name) == "x29":
        from scenarios.x29.flying import fly_loop
        from scenarios.x29.study import loop_scenario

        loop = loop_scenario(name, changes)
        with named_after(scenario_file(name)):
            return fly_loop(loop.flight, loop.seed if seed is None else seed).record
    from scenarios.studies.flying import fly_scenario

    scenario = load_scenario(name, changes)
    with named_after(scenario_file(name)):
        return fly_scenario(scenario, scenario.seed if seed is None else seed)[0]
