"""Campaigns of the tracing loop: flights, printed tables and written files of each.

Every campaign is a `Campaign`; `fly_and_tell` flies it, prints its tables and writes its folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from exam.clean import MODELS, CleanRun, clean_flight, clean_rows
from exam.detection import (
    SETTINGS,
    WEAK,
    Alarm,
    Detection,
    alarm_rows,
    clean_run,
    detection_rows,
    weak_run,
    weak_setting,
)
from exam.options import exam_reproduction
from exam.repeated import Flights, FlownCampaign, LoopFlights, fly_all
from scenarios.files.declarations import named_after
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json
from scenarios.report.document import PURE, Cell, Column, Page, as_sentence, capital, now, section
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.folder import write_page
from scenarios.report.summary import details_in, terminal_width, written_to
from scenarios.report.terminal import (
    cell_text,
    heading_text,
    progress_bar,
    rows_table,
    table_as_lines,
)
from scenarios.tasks.study import Execution, ShowProgress, stopped

ROOT = 1  # default root seed, unless the scenario has one
# Expected gain of the log likelihood of a weak effect; nearly all such effects are detected.
GAIN = 25.0
CLEAN = (
    Column("model"),
    Column("runs", PURE),
    Column("false claims", PURE),
    Column("95 % interval, %", right=True),
    Column("not consistent", PURE),
    Column("within two sigmas, %", PURE),
    Column("sigma over bound", PURE),
    Column("median time", "s"),
)
ALARMS = (
    Column("setting"),
    Column("runs", PURE),
    Column("false claims", PURE),
    Column("not consistent", PURE),
    Column("95 % interval of false claims, %", right=True),
    Column("median time", "s"),
)
DETECTED = (
    Column("effect"),
    *(
        Column(heading, PURE)
        for heading in ("runs", "detected", "named right", "among alternatives", "unexplained")
    ),
    Column("named wrong", PURE),
    Column("detected, 95 % interval, %", right=True),
)
Rows = list[tuple[Cell, ...]]


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign of the tracing loop.

    Attributes
    ----------
    name, where : name of the campaign, and its name in messages.
    root : default root seed.
    work : makes the tasks of the flights.
    times : flights in a run.
    text : returns the text for a number of columns; its last argument names the place of further
        details.
    write : writes the results into a folder, with figures.
    """

    name: str
    where: str
    root: int
    work: Flights
    times: int
    text: Callable[[FlownCampaign, int, str], str]
    write: Callable[[FlownCampaign, Path, Formats], Path]

    def fly(
        self,
        runs: int,
        seed: int | None,
        execution: Execution,
        tell: ShowProgress = lambda stage, share: None,
    ) -> FlownCampaign:
        """Fly all flights of ``runs`` runs; after Ctrl-C, return those that had ended. Raises as
        ``fly_all``.
        """
        root = self.root if seed is None else seed
        with named_after(self.where):
            return fly_all(self.work, runs * self.times, root, execution, tell)


def fly_and_tell(
    campaign: Campaign,
    runs: int,
    seed: int | None,
    execution: Execution,
    figures: Formats = USUAL,
    *,
    progress: bool = True,
) -> None:
    """Fly and diagnose, print the tables, and write the results into ``execution.out``.

    Raises
    ------
    KeyboardInterrupt : it was stopped; the flights that had ended are printed and written.
    """
    out = execution.out
    with progress_bar(progress) as tell:
        done = campaign.fly(runs, seed, execution, tell)
    print(campaign.text(done, terminal_width(), details_in(out)), end="")
    if out is not None:
        campaign.write(done, out, figures)
        print(written_to(out))
    if not done.whole:
        raise stopped(done.ended, done.asked, "flights", out)


def hidden_effect_campaign(name: str, changes: Sequence[str] = ()) -> Campaign:
    """Return the campaign of one hidden-effect scenario, by its name or the path of its file.

    Raises
    ------
    FlightidError : there is none of that name, or something is declared that cannot be.
    """
    from exam.hidden_effects import (
        campaign_page,
        named_scenario,
        trace_campaign_text,
        trace_flights,
        write_trace_campaign,
    )
    from scenarios.studies.catalogue import scenario_file

    scenario = named_scenario(name, tuple(changes))

    def write(done: FlownCampaign, out: Path, figures: Formats) -> Path:
        page = partial(campaign_page, scenario, done)
        return write_trace_campaign(scenario, done, out, page, figures)

    def text(done: FlownCampaign, width: int, details: str) -> str:
        return trace_campaign_text(scenario, done.found, done.words, width)

    work = trace_flights(name, changes)
    return Campaign(scenario.name, scenario_file(name), scenario.seed, work, 1, text, write)


def surrogate_campaign(name: str, changes: Sequence[str] = ()) -> Campaign:
    """Return the campaign of surrogate flights of one declaration; raises as ``load_surrogate``."""
    from exam.surrogates.campaign import campaign_text, surrogate_flights, write_campaign
    from exam.surrogates.report import campaign_page
    from exam.surrogates.schema import load_surrogate
    from scenarios.studies.catalogue import scenario_file

    surrogate = load_surrogate(name, changes)

    def write(done: FlownCampaign, out: Path, figures: Formats) -> Path:
        return write_campaign(
            surrogate, done, out, partial(campaign_page, surrogate, done), figures
        )

    def text(done: FlownCampaign, width: int, details: str) -> str:
        return campaign_text(surrogate, done.found, done.words, width, details)

    work = surrogate_flights(surrogate)
    return Campaign(surrogate.name, scenario_file(name), surrogate.seed, work, 1, text, write)


def every_effect_campaign(runs: int, effects: Sequence[str] | None = None) -> Campaign:
    """Return the campaign of flights of each of the ``effects`` (None: all of the library); its
    page names ``runs``.

    Raises
    ------
    DeclarationError : the library has no such effect.
    """
    from exam.every_effect.campaign import NAME, every_effect_text, write_every_effect
    from exam.every_effect.work import EveryEffect

    work = EveryEffect(None if effects is None else tuple(effects))

    def write(done: FlownCampaign, out: Path, figures: Formats) -> Path:
        return write_every_effect(done, runs, work.effects, out, figures)

    def text(done: FlownCampaign, width: int, details: str) -> str:
        return every_effect_text(done, width)

    return Campaign(NAME, NAME, ROOT, work, len(work.kinds), text, write)


@dataclass(frozen=True)
class Tabled:
    """A campaign with a single table: ``fly`` returns a dataclass of the ``kind`` for a flight's
    number and seed, and ``rows`` returns the cells of the ``columns`` for all flights.
    """

    fly: Callable[[int, int], Any]
    kind: Any
    title: str
    columns: tuple[Column, ...]
    rows: Callable[[Sequence[Any]], Rows]


def tabled_campaign(name: str) -> Campaign:
    """Return a campaign of ``TABLED`` by its name."""
    tabled = TABLED[name]

    def text(done: FlownCampaign, width: int, details: str) -> str:
        shown = rows_table(tabled.title, tabled.columns, tabled.rows(done.found))
        table = table_as_lines(shown)
        return "\n".join([f"{name}: {done.ended} flights, {done.words}", *table]) + "\n"

    def write(done: FlownCampaign, out: Path, figures: Formats) -> Path:
        rows = tabled.rows(done.found)
        content = {"schema": "flightid/campaign/1", "scenario": name, **done.content}
        headings = [heading_text(column) for column in tabled.columns]
        table = [dict(zip(headings, map(cell_text, row), strict=True)) for row in rows]
        with study_folder(out, "campaign.json") as scratch:
            write_page(scratch, _page(name, tabled, done, rows))
            document = {**content, "table": table, "versions": versions()}
            write_json(scratch / "campaign.json", document)
        return out

    work = LoopFlights(name, tabled.fly, tabled.kind, {})
    return Campaign(name, name, ROOT, work, 1, text, write)


def _page(name: str, tabled: Tabled, done: FlownCampaign, rows: Rows) -> Page:
    command = (name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(name.replace('-', ' '))}: {done.ended} flights",
        kind="Campaign of the tracing loop",
        verdict="",
        tone="plain",
        sentence=as_sentence(tabled.title),
        summary=(),
        warnings=(as_sentence(done.failed),) if done.failed else (),
        sections=section("What was found", rows_table(tabled.title, tabled.columns, rows)),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )


def _clean_of_setting(number: int, seed: int) -> Alarm:
    return clean_run(SETTINGS[number % len(SETTINGS)], seed)


def _weak(number: int, seed: int) -> Detection:
    effect = tuple(WEAK)[number % len(WEAK)]
    return weak_run(weak_setting(effect), effect, GAIN, seed)


def _clean_of_model(number: int, seed: int) -> CleanRun:
    return clean_flight(seed, MODELS[number % len(MODELS)])


def _alarm_rows(found: Sequence[Alarm]) -> Rows:
    groups = {
        setting.label: [each for each in found if each.setting == setting.label]
        for setting in SETTINGS
    }
    return alarm_rows(
        {label: group for label, group in groups.items() if group} | {"all": [*found]}
    )


def _detection_rows(found: Sequence[Detection]) -> Rows:
    by_effect = detection_rows(found, lambda each: each.effect)
    return by_effect + detection_rows(found, lambda each: "all")


TABLED: Mapping[str, Tabled] = {
    "false-alarms": Tabled(
        _clean_of_setting, Alarm, "clean records: nothing is hidden", ALARMS, _alarm_rows
    ),
    "clean": Tabled(
        _clean_of_model,
        CleanRun,
        "clean records: nothing is hidden; sigmas over the Cramer-Rao bound, median and 90 % of "
        "them",
        CLEAN,
        clean_rows,
    ),
    "weak-effects": Tabled(
        _weak, Detection, f"one weak effect, expected gain {GAIN:g}", DETECTED, _detection_rows
    ),
}
