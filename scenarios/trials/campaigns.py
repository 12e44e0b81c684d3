"""Campaigns of the tracing loop whose flights are marked: what each flies, tells and writes, the same for the command and for Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from scenarios.files.declarations import named_after
from scenarios.plots.formats import Formats
from scenarios.tasks.manner import Manner
from scenarios.tasks.study import Tell
from scenarios.trials.marks.content import marked_cells
from scenarios.trials.marks.rates import Marks
from scenarios.trials.names import EVERY
from scenarios.trials.repeated import Flights, Flown, fly_all
from sim.errors import DeclarationError

ROOT = 1  # of the seeds, where none is asked for and no scenario has one


@dataclass(frozen=True, eq=False)
class LoopCampaign:
    """A campaign: what is done in a flight (``work``), ``times`` flights in a run, ``root`` of the seeds where none is asked for.

    ``text`` tells what has been flown in so many columns, and where more is to be read; ``write`` puts it into a folder with figures; ``marks`` and
    ``cells`` are its statistics and its rows. ``where`` is what messages name.
    """

    name: str
    where: str
    root: int
    work: Flights
    times: int
    text: Callable[[Flown, int, str], str]
    write: Callable[[Flown, Path, Formats], Path]
    marks: Callable[[Sequence[Any]], Marks]
    cells: Callable[[Any], Mapping[str, Any]]

    def fly(self, runs: int, seed: int | None, manner: Manner, tell: Tell = lambda stage, share: None) -> Flown:
        """All flights of so many runs, or after Ctrl-C those that had ended; raises as ``fly_all``."""
        with named_after(self.where):
            return fly_all(self.work, runs * self.times, self.root if seed is None else seed, manner, tell)


def loop_campaign(name: str, runs: int, changes: Sequence[str] = (), effects: Sequence[str] | None = None) -> LoopCampaign:
    """The campaign of a tracing scenario, of a stand-in, or of every effect, by its name; ``runs`` is what its page says.

    Raises
    ------
    FlightidError : there is none of that name, or something is declared that cannot be.
    """
    if name == EVERY:
        return _every_effect(runs, changes, effects)
    from scenarios.studies.catalogue import scenario_kind

    kind = scenario_kind(name)
    if kind not in _OF_KIND:
        raise DeclarationError(f"there is no campaign of the loop of a scenario of kind {kind}", where=name, remedy="name trace-... or standin-...")
    return _OF_KIND[kind](name, changes)


def _trace(name: str, changes: Sequence[str]) -> LoopCampaign:
    from scenarios.studies.catalogue import scenario_file
    from scenarios.trials.planted.campaign import marks_of, named_scenario, trace_flights
    from scenarios.trials.planted.campaign_text import trace_campaign_text, write_trace_campaign
    from scenarios.trials.planted.page import campaign_page

    scenario = named_scenario(name, tuple(changes))

    def write(done: Flown, out: Path, figures: Formats) -> Path:
        return write_trace_campaign(scenario, done, out, partial(campaign_page, scenario, done), figures)

    def text(done: Flown, width: int, details: str) -> str:
        return trace_campaign_text(scenario, done.found, done.words, width)

    work = trace_flights(name, changes)
    return LoopCampaign(scenario.name, scenario_file(name), scenario.seed, work, 1, text, write, marks_of, _judged_cells)


def _standin(name: str, changes: Sequence[str]) -> LoopCampaign:
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.standin.campaign import marks_of, standin_flights
    from scenarios.trials.standin.campaign_text import campaign_text, write_campaign
    from scenarios.trials.standin.page import campaign_page
    from scenarios.trials.standin.schema import standin_of

    standin = standin_of(*load_document(name, changes))

    def write(done: Flown, out: Path, figures: Formats) -> Path:
        return write_campaign(standin, done, out, partial(campaign_page, standin, done), figures)

    def text(done: Flown, width: int, details: str) -> str:
        return campaign_text(standin, done.found, done.words, width, details)

    work = standin_flights(standin)
    return LoopCampaign(standin.name, scenario_file(name), standin.seed, work, 1, text, write, marks_of, _judged_cells)


def _every_effect(runs: int, changes: Sequence[str], effects: Sequence[str] | None) -> LoopCampaign:
    from scenarios.trials.every_effect.campaign import cells_of, every_effect_text, marks_of, write_every_effect
    from scenarios.trials.every_effect.work import EveryEffect

    if changes:
        raise DeclarationError(f"nothing of {EVERY} can be changed", where="--set", remedy="leave it out")
    work = EveryEffect(None if effects is None else tuple(effects))

    def write(done: Flown, out: Path, figures: Formats) -> Path:
        return write_every_effect(done, runs, work.effects, out, figures)

    def text(done: Flown, width: int, details: str) -> str:
        return every_effect_text(done, width)

    return LoopCampaign(EVERY, EVERY, ROOT, work, len(work.kinds), text, write, marks_of, cells_of)


def _judged_cells(judged: Any) -> Mapping[str, Any]:
    return {"seed": judged.seed, **({} if judged.marked is None else marked_cells(judged.marked))}


_OF_KIND: Mapping[str, Callable[[str, Sequence[str]], LoopCampaign]] = {"trace": _trace, "standin": _standin}
