"""Commands on measured records: each reads, computes, prints and writes a study folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from scenarios.compatibility import check_files
from scenarios.compatibility_report import print_check
from scenarios.files.measured.columns import read_record_file, with_names
from scenarios.files.writing import unwritable, write_text
from scenarios.identification.assessment import DEFAULT_OPTIONS, Options
from scenarios.identification.cautions import LIFT_OUTPUTS, NO_LIFT
from scenarios.maneuvers import maneuvers_of, print_maneuvers
from scenarios.prediction import PredictionRequest, predict_record, prediction_text
from scenarios.preparation.draft_text import (
    constant_words,
    map_text,
    missing_channels,
    unused_words,
    vehicle_text,
)
from scenarios.preparation.drafting import COMMANDS, Draft, drafted, named_only
from scenarios.preparation.plan import Plan, Request, plan_of
from scenarios.report.figure_formats import Formats
from scenarios.report.quantities import Shown, console, shown_in, unit_cell
from scenarios.report.summary import (
    TableColumn,
    details_in,
    print_paragraph,
    table_lines,
    terminal_width,
    written_to,
)
from scenarios.report.terminal import progress_bar
from scenarios.responses.analysis import ResponseOptions, responses_of
from scenarios.responses.fitting import FitOptions, ModelOptions
from scenarios.responses.qualities import LevelOptions, pilot_demand
from scenarios.responses.reading import Names
from scenarios.responses.report import print_responses
from sim.errors import DeclarationError, RecordError

if TYPE_CHECKING:
    from scenarios.structure import StructureOptions

# Shares of the work, in the progress bar, that are done when the writing of a study begins.
WRITING_SURVEY_SHARE, WRITING_DIAGNOSIS_SHARE = 0.98, 0.97

# ---- flightid check: sensor faults by kinematics


def check_records(request: Request, out: Path | None, figures: Formats) -> None:
    """Check records, write the study into ``out`` and print the findings."""
    check = check_files(request)
    if out is not None:
        from scenarios.compatibility_report import write_check

        write_check(check, out, figures=figures)
    print_check(check, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid survey: all flights of a test campaign


def survey_records(
    file: Path,
    out: Path | None,
    jobs: int | None,
    figures: Formats,
    *,
    progress: bool = True,
    cluster: str | None = None,
) -> None:
    """Diagnose the new flights of a campaign, combine all flights, write and print the survey.

    Parameters
    ----------
    file : file that names the flights.
    out : folder of the survey; None keeps nothing.
    jobs : number of processes; None takes one for each core.
    figures : formats of the figures.
    progress : show a progress bar.
    cluster : address of a Dask scheduler.
    """
    from scenarios.survey.report import survey_text
    from scenarios.survey.survey import survey_flights
    from scenarios.tasks.processes import available_cores

    with TemporaryDirectory(prefix="flightid-") as temporary:
        folder = out if out is not None else Path(temporary) / "survey"
        with progress_bar(progress) as show_progress:
            try:
                survey = survey_flights(
                    file,
                    folder,
                    jobs or available_cores(),
                    figures if out is not None else (),
                    show_progress,
                    cluster,
                )
            except KeyboardInterrupt as interrupt:
                if out is not None:
                    raise
                raise KeyboardInterrupt("nothing is kept without --out") from interrupt
            if out is not None:
                from scenarios.survey.files import write_survey

                show_progress("writing the survey", WRITING_SURVEY_SHARE)
                write_survey(survey, out, figures=figures)
    print(survey_text(survey, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid identify: parameters from measured records

ALL_PARAMETERS = "all"  # value of --profile


def options_of(
    profile: Sequence[str] | None, band: tuple[float, float] | None, engine: str | None = None
) -> Options:
    """Return the options of an identification, without the method.

    Parameters
    ----------
    profile : parameters whose profile likelihood is computed, or ``["all"]``; None for none.
    band : frequency band, Hz.
    engine : implementation of the method.
    """
    if profile is None:
        return Options(None, band, engine)
    # An empty tuple means all parameters.
    names = () if ALL_PARAMETERS in profile else tuple(dict.fromkeys(profile))
    return Options(names, band, engine)


def identify_records(
    request: Request,
    method: str,
    out: Path | None,
    figures: Formats,
    options: Options = DEFAULT_OPTIONS,
    matrices: Path | None = None,
) -> None:
    """Identify records, then write and print the study.

    Parameters
    ----------
    request : the records, the model and how the records are read.
    method : method of identification.
    out : folder of the study; None writes nothing.
    figures : formats of the figures.
    options : options of the method.
    matrices : file for the matrices A, B, C, D of the linearised model; None writes none.
    """
    from scenarios.files.measured.columns import path_of
    from scenarios.identification.files import refuse_place, state_space_of, write_state_space
    from scenarios.identification.identify import identify_files
    from scenarios.identification.report import print_identification

    if matrices is not None:
        study_files = [out / "comparison.json", out / "record.csv"] if out is not None else []
        record_paths = [path_of(record) for record in (*request.records, *request.validate)]
        record_files = [path for path in record_paths if path is not None]
        refuse_place(matrices, [*record_files, *study_files])
    identified = identify_files(request, method, options)
    state_space = state_space_of(identified.found) if matrices is not None else None
    if out is not None:
        from scenarios.identification.files import write_identification

        write_identification(identified, out, figures=figures)
    print_identification(identified.found, identified.flown, details=details_in(out))
    if matrices is not None and state_space is not None:
        write_state_space(state_space, matrices)
        print(f"matrices written to {matrices}")
    if out is not None:
        print(written_to(out))


# ---- flightid maneuvers: the maneuvers in a long record


def search_record(
    record: Path, channels: Path | None, plan: Plan, out: Path | None, figures: Formats
) -> None:
    """Find the maneuvers of a record, write them into ``out`` and print them."""
    from scenarios.files.declarations import read_channel_map

    choices = read_channel_map(channels, surfaces=True) if channels is not None else None
    maneuvers = maneuvers_of(record, choices, plan)
    if out is not None:
        from scenarios.maneuvers import write_maneuvers

        write_maneuvers(maneuvers, out, figures=figures)
    print_maneuvers(maneuvers, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid predict: another record predicted with the model of a study


def predict_with_study(request: PredictionRequest, out: Path | None, figures: Formats) -> None:
    """Predict a record with the model of a study, write the prediction and print it."""
    prediction = predict_record(request)
    if out is not None:
        from scenarios.prediction import write_prediction

        write_prediction(prediction, out, figures=figures)
    print(prediction_text(prediction, terminal_width()), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid response: frequency responses

Texts = tuple[str, ...]


def respond(
    request: Request,
    names: tuple[Texts, Texts, Texts],
    options: tuple[tuple[float, float] | None, tuple[float, ...], int, float],
    fit: tuple[Texts, Texts, bool],
    bandwidth: str | None,
    margins: str | None,
    levels: tuple[str | None, float | None],
    out: Path | None,
    figures: Formats,
    pilot: tuple[float | None, float | None] = (None, None),
    model: tuple[str | None, Path | None] = (None, None),
) -> None:
    """Estimate frequency responses, write them into ``out`` and print them.

    Parameters
    ----------
    request : the records and how they are read.
    names : inputs, outputs and references.
    options : band (Hz), windows (s), number of tapers, least coherence.
    fit : forms, fixed parameters, and whether poles are shared.
    bandwidth : whether the outputs are a "rate" or an "attitude".
    margins : sign with which the loop feeds the output back, "minus" or "plus".
    levels : aircraft class with category, and airspeed (m/s).
    out : folder of the study.
    figures : formats of the figures.
    pilot : closed-loop bandwidth (rad/s) and delay (s) of the pilot.
    model : linear model to fit, and its vehicle file.
    """
    responses = responses_of(
        request,
        Names(*names),
        ResponseOptions(*options),
        FitOptions(*fit),
        bandwidth,
        margins,
        LevelOptions(*levels),
        pilot_demand(*pilot),
        ModelOptions(*model),
    )
    if out is not None:
        from scenarios.responses.report import write_responses

        write_responses(responses, out, figures=figures)
    print_responses(responses, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid map

CHANNEL_MAP_FILE, VEHICLE_FILE = "channels.toml", "vehicle.toml"
MOST_EXPRESSION_LETTERS = 60  # characters of an expression in a table
MOST_TOPICS = 15  # topics that are shown without --topics
# If the same fault keeps every channel from being read, a draft is made from the names alone of at
# least so many channels.
FEWEST_NAMED = 2


def draft_map(
    path: Path, out: Path | None, rate: float | None, columns: str | None, topics: bool
) -> None:
    """Draft a channel map and a vehicle file for a record, print them or write them into ``out``.

    Parameters
    ----------
    path : the record.
    out : folder of the drafts; None prints them.
    rate : sampling rate (Hz) of a record without time.
    columns : names of the columns of a record without header.
    topics : show all topics of a log.

    Raises
    ------
    FlightidError : the file or all its columns cannot be read; ``out`` already holds a map or a
        vehicle file.
    """
    plan = plan_of(rate=rate, columns=columns)
    if out is not None:
        _refuse_existing_drafts(out)
    draft = drafted(with_names(read_record_file(path), plan.columns), plan.rate)
    unread = [guess.fault for guess in draft.guesses if guess.fault]
    if unread and not draft.readable:
        if len(set(unread)) > 1 or len(unread) < FEWEST_NAMED:
            raise RecordError(f"no channel can be read, so no map is drafted: {unread[0]}")
        draft = named_only(draft)
    _print_topics(draft, all_topics=topics)
    _print_channels(draft)
    text = map_text(draft)
    for fault in draft.faults:
        if out is not None or fault not in text:
            print(f"fault: {fault}")
    for note in draft.file.notes:
        print(f"note: {note}")
    if out is None:
        print(f"\n{text}", end="")
        print(f"\n{vehicle_text(draft)}", end="")
        return
    if draft.constant:
        print_paragraph(console(), constant_words(draft), indent=0)
    if draft.unused and len(draft.topics) == 1:
        print_paragraph(console(), unused_words(draft), indent=0)
    _write_drafts(out, draft)
    print(f"\n{out / CHANNEL_MAP_FILE}, {out / VEHICLE_FILE}: drafts to check and complete")
    if idle := _idle_motors_sentence(draft):
        print_paragraph(console(), f"next: {idle}", indent=0)
    elif draft.model:
        _print_identify_command(draft, path, out, rate, columns)
    else:
        missing = missing_channels(draft)
        absent = f"not found: {', '.join(missing)}; " if missing else ""
        print_paragraph(
            console(),
            f"next: {absent}write the columns of the channels that your model needs into "
            f"{out / CHANNEL_MAP_FILE} (flightid models lists them)",
            indent=0,
        )


def _print_identify_command(
    draft: Draft, path: Path, out: Path, rate: float | None, columns: str | None
) -> None:
    """Print what the drafts lack, and the command that identifies the record with them."""
    if draft.model == "rigid" and not LIFT_OUTPUTS & {guess.channel for guess in draft.guesses}:
        print_paragraph(console(), f"needed: {NO_LIFT}", indent=0)
    commands = [guess.channel for guess in draft.guesses if guess.command and not guess.fault]
    if commands:
        print_paragraph(
            console(),
            f"first: {', '.join(commands)} commanded from -1 to 1; enter the "
            f"surface's angle in {out / CHANNEL_MAP_FILE}",
            indent=0,
        )
    options = ["--channels", str(out / CHANNEL_MAP_FILE), "--vehicle", str(out / VEHICLE_FILE)]
    if rate is not None:
        options += ["--rate", f"{rate:g}"]
    elif draft.clockless:
        options += ["--rate", "HZ"]
    if columns:
        options += ["--columns", columns]
    print(f"next: flightid identify {path} --model {draft.model} {' '.join(options)}")


def _idle_motors_sentence(draft: Draft) -> str:
    """Return a sentence if all commands in the log of a multirotor are zero; else an empty text."""
    commands = [guess for guess in draft.guesses if guess.channel in COMMANDS and guess.samples]
    idle = [guess.channel for guess in commands if guess.least == guess.most == 0.0]
    if draft.model != "multirotor" or not commands or "thrust_command" not in idle:
        return ""
    return (
        f"{', '.join(idle)}: zero throughout, so the motors moved nothing; take a log of a flight"
    )


def _print_topics(draft: Draft, *, all_topics: bool) -> None:
    """Print the rows, rate and columns of each topic; of a large log only the largest topics."""
    if len(draft.topics) == 1:
        (topic,) = draft.topics
        rate = f", {topic.rate:.4g} samples a second" if topic.rate else ""
        print(f"{draft.file.path.name}: {topic.rows} rows of {len(topic.columns)} columns{rate}")
        return
    print(f"{draft.file.path.name}: a log of {len(draft.topics)} topics")
    shown = list(draft.topics)
    if not all_topics:
        shown = sorted(shown, key=lambda topic: -topic.rows)[:MOST_TOPICS]
    names = [_shortened(", ".join(topic.columns), MOST_EXPRESSION_LETTERS) for topic in shown]
    _print_table(
        [
            TableColumn("topic", [topic.name for topic in shown], left=True),
            TableColumn("rows", [str(topic.rows) for topic in shown]),
            TableColumn("Hz", [f"{topic.rate:.4g}" if topic.rate else "" for topic in shown]),
            TableColumn("columns", names, left=True),
        ]
    )
    if len(shown) < len(draft.topics):
        print(f"{len(draft.topics) - len(shown)} smaller topics are not shown; --topics shows all")


def _print_channels(draft: Draft) -> None:
    """Print a table of the channels that were recognised, with their columns and ranges."""
    from scenarios.files.declarations import CHANNEL_UNITS

    if draft.faults and not any(guess.samples for guess in draft.guesses):
        names = [guess.channel for guess in draft.guesses]
        if names:
            print(f"channels by their names alone, as no value can be read: {', '.join(names)}")
            return
    usable = [guess for guess in draft.guesses if not guess.fault and guess.samples]
    if not usable:
        print("no channel was recognised by its name")
        return
    units = [
        Shown(1.0, "command")
        if guess.command
        else shown_in(CHANNEL_UNITS[guess.channel], guess.channel)
        for guess in usable
    ]
    sources = [_shortened(str(guess.choice.column), MOST_EXPRESSION_LETTERS) for guess in usable]
    guesses = [(guess, factor) for guess, (factor, _) in zip(usable, units, strict=True)]
    _print_table(
        [
            TableColumn("channel", [guess.channel for guess in usable], left=True),
            TableColumn("from", sources, left=True),
            TableColumn("samples", [str(guess.samples) for guess in usable]),
            TableColumn("least", [f"{factor * guess.least:.4g}" for guess, factor in guesses]),
            TableColumn("most", [f"{factor * guess.most:.4g}" for guess, factor in guesses]),
            TableColumn("unit", [unit_cell(unit) for _, unit in units], left=True),
        ]
    )


def _print_table(columns: list[TableColumn]) -> None:
    print("\n".join(f"  {line}" for line in table_lines(columns, width=terminal_width())))


def _refuse_existing_drafts(out: Path) -> None:
    """Raise DeclarationError if a folder has a channel map or a vehicle file."""
    for name in (CHANNEL_MAP_FILE, VEHICLE_FILE):
        if (out / name).exists():
            raise DeclarationError(
                "this file exists already",
                where=str(out / name),
                remedy="name another folder with --out",
            )


def _write_drafts(out: Path, draft: Draft) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / VEHICLE_FILE, vehicle_text(draft))
        write_text(out / CHANNEL_MAP_FILE, map_text(draft))
    except OSError as error:
        raise unwritable(out, error, "name another folder") from None


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."


# ---- flightid diagnose: what the model lacks


def diagnose_records(
    request: Request, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Diagnose the model of records, write the study and print it.

    ``progress`` : show a progress bar.
    """
    with progress_bar(progress, counted=False) as show_progress:
        from scenarios.diagnosis.diagnose import diagnose_files

        tracing = diagnose_files(request, show_progress)
        if out is not None:
            from scenarios.diagnosis.files import write_diagnosis

            show_progress("writing the study", WRITING_DIAGNOSIS_SHARE)
            write_diagnosis(tracing, out, figures=figures)
    from scenarios.diagnosis.text import diagnosis_text

    print(diagnosis_text(tracing, terminal_width(), details_in(out)))
    if out is not None:
        print(written_to(out))


# ---- flightid structure


def find_structure(
    request: Request, options: StructureOptions, out: Path | None, figures: Formats
) -> None:
    """Choose the terms of the aerodynamic coefficients, then write and print them.

    Parameters
    ----------
    request : records and vehicle file.
    options : how terms are offered and chosen.
    out : folder of the study; it also gets a vehicle file with the terms.
    figures : formats of the figures.
    """
    from scenarios.structure import structure_of_files
    from scenarios.structure_report import structure_text, write_structure

    structure = structure_of_files(request, options)
    if out is not None:
        write_structure(structure, out, figures=figures)
    print(structure_text(structure, terminal_width(), details_in(out)), end="")
    if out is not None:
        names = " ".join(str(record) for record in request.records)
        channels = "" if request.channels is None else f"--channels {request.channels} "
        print(
            f"refine: flightid identify {names} --model aircraft --vehicle {out / VEHICLE_FILE} "
            f"{channels}--out FIT"
        )
        print(written_to(out))


# ---- flightid export


def export_model(study: Path, to: str, out: Path | None, model: Path | None) -> None:
    """Write the model of a study for another program, and print a line on it.

    Parameters
    ----------
    study : folder of the study.
    to : the other program or format, a target of ``written_model``.
    out : file or folder to write; None takes the name of the vehicle.
    model : file of a user's own model.
    """
    from scenarios.export.targets import written_model

    path, exported, description = written_model(study, to, out, model)
    print(f"{path}: {exported.model} model of {exported.name}, {description}")
    for remark in exported.remarks:
        print(f"note: {remark}")
