"""Work of the commands on measured records: printed and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from scenarios.compatibility.check import check_files
from scenarios.compatibility.report import print_check
from scenarios.files.measured.columns import read_record_file, with_names
from scenarios.files.writing import write_text
from scenarios.identification.assessment import DEFAULT_OPTIONS, Options
from scenarios.identification.cautions import LIFT_OUTPUTS, NO_LIFT
from scenarios.maneuvers import maneuvers_of, print_maneuvers
from scenarios.prediction import PredictionRequest, predict_record, prediction_text
from scenarios.preparation.declared_model import vehicle_text
from scenarios.preparation.draft_text import (
    constant_words,
    map_text,
    missing_channels,
    unused_words,
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
    from scenarios.structure.study import StructureOptions

# ---- flightid check: sensor faults by kinematics


def check_records(request: Request, out: Path | None, figures: Formats) -> None:
    """Check records, write the study into ``out`` and print the findings."""
    found = check_files(request)
    if out is not None:
        from scenarios.compatibility.report import write_check

        write_check(found, out, figures=figures)
    print_check(found, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid survey: all flights of a test campaign, printed and written


def survey_records(
    file: Path,
    out: Path | None,
    jobs: int | None,
    figures: Formats,
    *,
    progress: bool = True,
    cluster: str | None = None,
) -> None:
    """Diagnose the new flights of a campaign, pool all of them, write and print the survey.

    ``progress`` : whether a progress bar is shown. ``cluster`` : address of a Dask scheduler.
    """
    from scenarios.survey.report import survey_text
    from scenarios.survey.survey import survey_flights
    from scenarios.tasks.processes import available_cores

    with TemporaryDirectory(prefix="flightid-") as passing:
        folder = out if out is not None else Path(passing) / "survey"
        with progress_bar(progress) as tell:
            try:
                found = survey_flights(
                    file,
                    folder,
                    jobs or available_cores(),
                    figures if out is not None else (),
                    tell,
                    cluster,
                )
            except KeyboardInterrupt as stopped:
                if out is not None:
                    raise
                raise KeyboardInterrupt("nothing is kept without --out") from stopped
            if out is not None:
                from scenarios.survey.files import write_survey

                tell("writing the survey", 0.98)
                write_survey(found, out, figures=figures)
    print(survey_text(found, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid identify: a measured record to parameters, printed and written

ALL_PARAMETERS = "all"  # value of --profile


def options_of(
    profile: Sequence[str] | None, band: tuple[float, float] | None, engine: str | None = None
) -> Options:
    """Return the options of an identification other than the method."""
    names = (
        None
        if profile is None
        else ()
        if ALL_PARAMETERS in profile
        else tuple(dict.fromkeys(profile))
    )
    return Options(names, band, engine)


def identify_records(
    request: Request,
    method: str,
    out: Path | None,
    figures: Formats,
    options: Options = DEFAULT_OPTIONS,
    matrices: Path | None = None,
) -> None:
    """Identify records, write the study and the linearised model's ``matrices``, and print."""
    from scenarios.files.measured.columns import path_of
    from scenarios.identification.files import refuse_place, state_space_of, write_state_space
    from scenarios.identification.identify import identify_files
    from scenarios.identification.report import print_identification

    if matrices is not None:
        ours = [out / "comparison.json", out / "record.csv"] if out is not None else []
        given = [
            path
            for record in (*request.records, *request.validate)
            if (path := path_of(record)) is not None
        ]
        refuse_place(matrices, [*given, *ours])
    identified = identify_files(request, method, options)
    space = state_space_of(identified.found) if matrices is not None else None
    if out is not None:
        from scenarios.identification.files import write_identification

        write_identification(identified, out, figures=figures)
    print_identification(identified.found, identified.flown, details=details_in(out))
    if matrices is not None and space is not None:
        write_state_space(space, matrices)
        print(f"matrices written to {matrices}")
    if out is not None:
        print(written_to(out))


# ---- flightid maneuvers: the maneuvers in a long record, printed and written


def search_record(
    record: Path, channels: Path | None, plan: Plan, out: Path | None, figures: Formats
) -> None:
    """Find the maneuvers of a record, write them into ``out`` and print them."""
    from scenarios.files.declarations import read_channel_map

    choices = read_channel_map(channels, surfaces=True) if channels is not None else None
    found = maneuvers_of(record, choices, plan)
    if out is not None:
        from scenarios.maneuvers import write_maneuvers

        write_maneuvers(found, out, figures=figures)
    print_maneuvers(found, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid predict: the model of a study on another record, printed and written


def predict_with_study(asked: PredictionRequest, out: Path | None, figures: Formats) -> None:
    """Predict a record with the model of a study, write the prediction and print it."""
    found = predict_record(asked)
    if out is not None:
        from scenarios.prediction import write_prediction

        write_prediction(found, out, figures=figures)
    print(prediction_text(found, terminal_width()), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid response: frequency responses, printed and written

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

    ``names`` : inputs, outputs, references. ``options`` : band, windows, tapers, least coherence.
    ``fit`` : forms, fixed parameters, shared poles. ``bandwidth`` : rate or attitude, what the
    outputs are. ``margins`` : minus or plus, how the loop takes back the output. ``levels`` : class
    and category, airspeed. ``pilot`` : closed-loop bandwidth, rad/s, and delay, s.
    ``model`` : a linear model to fit, and its vehicle file.
    """
    found = responses_of(
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

        write_responses(found, out, figures=figures)
    print_responses(found, details=details_in(out))
    if out is not None:
        print(written_to(out))


# ---- flightid map

CHANNEL_MAP_FILE, VEHICLE_FILE = "channels.toml", "vehicle.toml"
MOST_EXPRESSION_LETTERS = 60  # characters of an expression


FEWEST_NAMED = 2  # channels of a file with one fault, of which a draft is made all the same


def draft_map(
    path: Path, out: Path | None, rate: float | None, columns: str | None, topics: bool
) -> None:
    """Print the topics, the channels found with their ranges, every fault, and the draft; write it
    where ``out`` is given.

    Raises
    ------
    FlightidError : the file cannot be read, or none of its columns; ``out`` holds a map or vehicle
        file already.
    """
    plan = plan_of(rate=rate, columns=columns)
    if out is not None:
        _refuse_present(out)
    draft = drafted(with_names(read_record_file(path), plan.columns), plan.rate)
    unread = [guess.fault for guess in draft.guesses if guess.fault]
    if unread and not draft.readable:
        if len(set(unread)) > 1 or len(unread) < FEWEST_NAMED:
            raise RecordError(f"no channel can be read, so no map is drafted: {unread[0]}")
        draft = named_only(draft)
    _print_topics(draft, whole=topics)
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
    _write(out, draft)
    print(f"\n{out / CHANNEL_MAP_FILE}, {out / VEHICLE_FILE}: drafts to check and complete")
    if idle := _idle_words(draft):
        print_paragraph(console(), f"next: {idle}", indent=0)
    elif draft.model:
        if draft.model == "rigid" and not LIFT_OUTPUTS & {guess.channel for guess in draft.guesses}:
            print_paragraph(console(), f"needed: {NO_LIFT}", indent=0)
        # What opened the file here opens it there.
        opening = [
            f"--rate {rate:g}" if rate is not None else "--rate HZ" if draft.clockless else "",
            f"--columns {columns}" if columns else "",
        ]
        words = " ".join(word for word in opening if word)
        files = f"--channels {out / CHANNEL_MAP_FILE} --vehicle {out / VEHICLE_FILE}"
        commands = [guess.channel for guess in draft.guesses if guess.command and not guess.fault]
        if commands:
            print_paragraph(
                console(),
                f"first: {', '.join(commands)} commanded from -1 to 1; enter the "
                f"surface's angle in {out / CHANNEL_MAP_FILE}",
                indent=0,
            )
        print(
            f"next: flightid identify {path} --model {draft.model} "
            f"{files}{f' {words}' if words else ''}"
        )
    else:
        missing = missing_channels(draft)
        absent = f"not found: {', '.join(missing)}; " if missing else ""
        print_paragraph(
            console(),
            f"next: {absent}write the columns of the channels that your model needs into "
            f"{out / CHANNEL_MAP_FILE} (flightid models lists them)",
            indent=0,
        )


def _idle_words(draft: Draft) -> str:
    """What to do if the log of a multirotor has no command that moves; else empty."""
    commands = [guess for guess in draft.guesses if guess.channel in COMMANDS and guess.samples]
    still = [guess.channel for guess in commands if guess.least == guess.most == 0.0]
    if draft.model != "multirotor" or not commands or "thrust_command" not in still:
        return ""
    return (
        f"{', '.join(still)}: zero throughout, so the motors moved nothing; take a log of a flight"
    )


def _print_topics(draft: Draft, *, whole: bool) -> None:
    if len(draft.topics) == 1:
        (topic,) = draft.topics
        rate = f", {topic.rate:.4g} samples a second" if topic.rate else ""
        print(f"{draft.file.path.name}: {topic.rows} rows of {len(topic.columns)} columns{rate}")
        return
    print(f"{draft.file.path.name}: a log of {len(draft.topics)} topics")
    shown = draft.topics if whole else sorted(draft.topics, key=lambda topic: -topic.rows)[:15]
    _table(
        [
            TableColumn("topic", [topic.name for topic in shown], left=True),
            TableColumn("rows", [str(topic.rows) for topic in shown]),
            TableColumn("Hz", [f"{topic.rate:.4g}" if topic.rate else "" for topic in shown]),
            TableColumn(
                "columns",
                [_short(", ".join(topic.columns), MOST_EXPRESSION_LETTERS) for topic in shown],
                left=True,
            ),
        ]
    )
    if len(shown) < len(draft.topics):
        print(f"{len(draft.topics) - len(shown)} smaller topics are not shown; --topics shows all")


def _print_channels(draft: Draft) -> None:
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
    _table(
        [
            TableColumn("channel", [guess.channel for guess in usable], left=True),
            TableColumn(
                "from",
                [_short(str(guess.choice.column), MOST_EXPRESSION_LETTERS) for guess in usable],
                left=True,
            ),
            TableColumn("samples", [str(guess.samples) for guess in usable]),
            TableColumn(
                "least",
                [
                    f"{factor * guess.least:.4g}"
                    for guess, (factor, _) in zip(usable, units, strict=True)
                ],
            ),
            TableColumn(
                "most",
                [
                    f"{factor * guess.most:.4g}"
                    for guess, (factor, _) in zip(usable, units, strict=True)
                ],
            ),
            TableColumn("unit", [unit_cell(unit) for _, unit in units], left=True),
        ]
    )


def _table(columns: list[TableColumn]) -> None:
    print("\n".join(f"  {line}" for line in table_lines(columns, width=terminal_width())))


def _refuse_present(out: Path) -> None:
    for name in (CHANNEL_MAP_FILE, VEHICLE_FILE):
        if (out / name).exists():
            raise DeclarationError(
                "there is such a file already",
                where=str(out / name),
                remedy="name another folder with --out",
            )


def _write(out: Path, draft: Draft) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / VEHICLE_FILE, vehicle_text(draft))
        write_text(out / CHANNEL_MAP_FILE, map_text(draft))
    except OSError as error:
        raise DeclarationError(
            f"cannot be written ({error.strerror or error})",
            where=str(out),
            remedy="name another folder",
        ) from None


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."


def diagnose_records(
    request: Request, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Trace what the model of a record lacks, write the study and print it.

    ``progress`` : whether a progress bar is shown.
    """
    with progress_bar(progress, counted=False) as tell:
        from scenarios.diagnosis.diagnose import diagnose_files

        tracing = diagnose_files(request, tell)
        if out is not None:
            from scenarios.diagnosis.report.files import write_diagnosis

            tell("writing the study", 0.97)
            write_diagnosis(tracing, out, figures=figures)
    from scenarios.diagnosis.report.text import diagnosis_text
    from scenarios.report.summary import details_in, terminal_width, written_to

    print(diagnosis_text(tracing, terminal_width(), details_in(out)))
    if out is not None:
        print(written_to(out))


# ---- flightid structure


def find_structure(
    request: Request, options: StructureOptions, out: Path | None, figures: Formats
) -> None:
    """Choose the terms of the aerodynamic coefficients, write a vehicle file of them and print.

    Parameters
    ----------
    request : records and vehicle file.
    options : how terms are offered and chosen.
    out : folder.
    """
    from scenarios.structure.report import structure_text, write_structure
    from scenarios.structure.study import structure_of_files

    found = structure_of_files(request, options)
    if out is not None:
        write_structure(found, out, figures=figures)
    print(structure_text(found, terminal_width(), details_in(out)), end="")
    if out is not None:
        names = " ".join(str(each) for each in request.records)
        channels = "" if request.channels is None else f"--channels {request.channels} "
        print(
            f"refine: flightid identify {names} --model aircraft --vehicle {out / VEHICLE_FILE} "
            f"{channels}--out FIT"
        )
        print(written_to(out))


# ---- flightid export


def export_model(study: Path, to: str, out: Path | None, model: Path | None) -> None:
    """Read the study's model, write it for a target, print a line: see ``written_model``."""
    from scenarios.export.targets import written_model

    path, found, told = written_model(study, to, out, model)
    print(f"{path}: {found.model} model of {found.name}, {told}")
    for remark in found.remarks:
        print(f"note: {remark}")
