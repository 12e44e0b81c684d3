"""Command lines of the campaigns of the tracing loop, and of single flights of them."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from exam.campaigns import (
    ROOT,
    TABLED,
    Campaign,
    every_effect_campaign,
    fly_and_tell,
    hidden_effect_campaign,
    surrogate_campaign,
    tabled_campaign,
)
from exam.options import Parser, ended_in_one_line, figures_of, manner_of, seed
from exam.surrogates.schema import USUAL_SURROGATE, load_surrogate, surrogate_names
from scenarios.files.declarations import named_after
from scenarios.report.summary import details_in, terminal_width, written_to
from scenarios.report.terminal import progress_bar
from scenarios.studies.catalogue import scenario_file
from sim.errors import DeclarationError


def tabled(name: str, arguments: Sequence[str] | None = None) -> int:
    """A campaign whose result is one table."""
    parser = Parser(name, TABLED[name].title)
    parser.add_campaign()
    asked = parser.parse_args(arguments)
    campaign = partial(tabled_campaign, name)
    return _fly(name, campaign, asked)


def hidden_effects(arguments: Sequence[str] | None = None) -> int:
    """Many flights of a hidden-effect scenario: how often what is hidden is named."""
    parser = Parser("hidden-effects", "a campaign of a hidden-effect scenario of the catalogue")
    parser.add_argument("name", metavar="NAME", help="trace-..., or a scenario file's path")
    parser.add_campaign()
    parser.add_changes()
    asked = parser.parse_args(arguments)
    return _fly("hidden-effects", partial(hidden_effect_campaign, asked.name, asked.changes), asked)


def surrogates(arguments: Sequence[str] | None = None) -> int:
    """Many surrogate flights: records that look measured, with one effect that dominates."""
    parser = Parser("surrogates", "a campaign of surrogate flights")
    _add_surrogate(parser)
    parser.add_campaign()
    asked = parser.parse_args(arguments)
    return _fly("surrogates", partial(surrogate_campaign, asked.name, asked.changes), asked)


def surrogate(arguments: Sequence[str] | None = None) -> int:
    """One surrogate flight diagnosed, and what was true of it."""
    parser = Parser("surrogate", "one surrogate flight, diagnosed")
    _add_surrogate(parser)
    parser.add_argument("--seed", type=seed, help="default: that of the file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the study")
    parser.add_figures()
    asked = parser.parse_args(arguments)

    def work() -> int:
        from exam.surrogates.report import surrogate_text, write_surrogate
        from exam.surrogates.study import run_surrogate

        declared, figures = load_surrogate(asked.name, asked.changes), figures_of(asked)
        with named_after(scenario_file(asked.name)), progress_bar(True, counted=False) as tell:
            study = run_surrogate(declared, asked.seed, tell)
        print(surrogate_text(study, terminal_width(), details_in(asked.out)), end="")
        if asked.out is not None:
            write_surrogate(study, asked.out, figures=figures)
            print(written_to(asked.out))
        return 0

    return ended_in_one_line("surrogate", work)


def surrogate_records(arguments: Sequence[str] | None = None) -> int:
    """The records of one surrogate flight as files, without the truth."""
    parser = Parser("surrogate-records", "records of one surrogate flight, the truth left out")
    _add_surrogate(parser)
    parser.add_argument("--seed", type=seed, help="default: that of the file")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    asked = parser.parse_args(arguments)

    def work() -> int:
        _write_records(asked.name, asked.changes, asked.seed, asked.out)
        return 0

    return ended_in_one_line("surrogate-records", work)


def every_effect(arguments: Sequence[str] | None = None) -> int:
    """Each effect of the library hidden in flights of its vehicles."""
    parser = Parser("every-effect", "each effect of the library, and nothing, hidden in turn")
    parser.add_campaign(runs_required=False)
    parser.add_argument("--effects", metavar="EFFECT,...", help="these alone")
    parser.add_argument("--only", type=int, metavar="NUMBER", help="one flight again")
    asked = parser.parse_args(arguments)
    named = asked.effects.split(",") if asked.effects is not None else []
    effects = None if asked.effects is None else [each.strip() for each in named if each.strip()]
    if (asked.runs is None) is (asked.only is None):
        parser.error("give one of --runs and --only")
    if asked.only is not None:
        if asked.only < 0 or asked.resume:
            parser.error("--only takes a number of 0 or more, and no --resume")
        return ended_in_one_line("every-effect", partial(_one_again, asked, effects))
    return _fly("every-effect", lambda: every_effect_campaign(asked.runs, effects), asked)


def _fly(name: str, campaign: Callable[[], Campaign], asked: Namespace) -> int:
    def work() -> int:
        if asked.runs < 2:
            raise DeclarationError(f"{asked.runs} runs", where="--runs", remedy="give two or more")
        execution, figures = manner_of(asked), figures_of(asked)
        fly_and_tell(campaign(), asked.runs, asked.seed, execution, figures)
        return 0

    return ended_in_one_line(name, work)


def _one_again(asked: Namespace, effects: Sequence[str] | None) -> int:
    from exam.every_effect.campaign import fly_one, one_text, write_one
    from exam.every_effect.work import EveryEffect

    work, figures = EveryEffect(None if effects is None else tuple(effects)), figures_of(asked)
    with progress_bar() as tell:
        one = fly_one(work, asked.only, ROOT if asked.seed is None else asked.seed, tell)
    print(one_text(one, terminal_width()), end="")
    if asked.out is not None:
        write_one(one, asked.out, figures=figures)
        print(written_to(asked.out))
    return 0


def _add_surrogate(parser: Parser) -> None:
    names = ", ".join(surrogate_names())
    text = f"{names}, or a file's path; default: {USUAL_SURROGATE}"
    parser.add_argument("name", nargs="?", default=USUAL_SURROGATE, metavar="NAME", help=text)
    parser.add_changes()


def _write_records(name: str, changes: Sequence[str], asked_seed: int | None, out: Path) -> None:
    """``FILE.csv`` asked for gives ``FILE_1.csv``, ``FILE_2.csv`` ... and ``FILE_vehicle.toml``."""
    from exam.surrogates.flights.flight import fly_surrogate, vehicle_text
    from scenarios.files.writing import files_together, write_record

    if out.suffix != ".csv":
        what = f"{out.suffix or 'no'} ending"
        raise DeclarationError(what, where=str(out), remedy="name a .csv file")
    declared = load_surrogate(name, changes)
    with named_after(scenario_file(name)):
        flight = fly_surrogate(declared, declared.seed if asked_seed is None else asked_seed)
    names = [f"{out.stem}_{number}" for number in range(1, len(flight.records) + 1)]
    vehicle = f"{out.stem}_vehicle.toml"
    with files_together(out) as scratch:
        for stem, record in zip(names, flight.records, strict=True):
            write_record(scratch, record, stem, simulated=True)
        text = vehicle_text(flight.drawn)
        (scratch / vehicle).write_text(text, encoding="utf-8", newline="\n")
    listed = f"{names[0]}.csv to {names[-1]}.csv"
    print(f"{len(names)} records of one flight: {listed}; for --vehicle: {vehicle}")
