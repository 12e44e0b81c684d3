"""Drafts of a channel map and of a vehicle file as TOML, printed or written by ``flightid map``.

A channel map has a line for each channel, and comments on missing channels and unused columns. A
vehicle file has the numbers that the record shows; other numbers are comments.
"""

from __future__ import annotations

import textwrap
import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np

from scenarios.files.aircraft_files import toml_string
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import RecordFile, read_record_file, with_names
from scenarios.files.writing import unwritable, write_text
from scenarios.preparation.declared_model import LIFT_OUTPUTS, NO_LIFT
from scenarios.preparation.drafting import (
    COMMANDS,
    SERVO_PULSES,
    SURFACES,
    Draft,
    drafted,
    named_only,
    topics_of,
)
from scenarios.preparation.plan import plan_of
from scenarios.report.quantities import Shown, console, shown_in, unit_cell
from scenarios.report.summary import TableColumn, print_paragraph, table_lines, terminal_width
from sim.errors import DeclarationError, RecordError

COMMENT_WIDTH = 100  # characters of a comment line
SERVO_ORDER = {"aileron": 0, "elevator": 1, "rudder": 3}  # usual number of a surface's servo output
# Nearest model -> channels that a draft reports as missing.
WANTED = {
    "multirotor": (*COMMANDS, "p", "q", "r", "az"),
    "lateral": ("aileron", "rudder", "beta", "p", "r", "phi"),
    "": ("elevator", "aileron", "rudder", "alpha", "beta", "q"),
}


def map_text(draft: Draft) -> str:
    """Return the draft as a channel map in TOML, with the reason for each line."""
    lines = [
        f"# Draft of a channel map for {draft.file.path.name}. Check every line: names do not say "
        "signs, and seldom units."
    ]
    for guess in draft.guesses:
        choice = guess.choice
        column = choice.column if isinstance(choice.column, int) else toml_string(choice.column)
        entry = str(column)
        if guess.command and not guess.fault:
            entry = f'{{column = {toml_string(f"THROW * {choice.column}")}, unit = "deg"}}'
        elif choice.unit is not None:
            entry = f"{{column = {column}, unit = {toml_string(choice.unit)}}}"
        reason = f"left out: {guess.fault}" if guess.fault else guess.reason
        comment_mark = "# " if guess.fault or guess.command else ""
        lines.append(f"{comment_mark}{guess.channel} = {entry}  # {reason}")
    missing = missing_channels(draft)
    if missing and draft.model in ("rigid", "lateral", "longitudinal"):
        lines.append(f"# Not found, and not needed by --model {draft.model}: {', '.join(missing)}.")
    elif missing:
        lines += [f"# Not found: {', '.join(missing)}. A line is such as", *_examples(draft)]
    sentences = [constant_words(draft)]
    if draft.unused and len(draft.topics) == 1:  # a log of several topics has hundreds of columns
        sentences.append(unused_words(draft))
    for sentence in sentences:
        lines += textwrap.wrap(
            f"{sentence}." if sentence else "",
            COMMENT_WIDTH,
            initial_indent="# ",
            subsequent_indent="# ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    lines += _sweep_comments(draft.file)
    return "\n".join(lines) + "\n"


def missing_channels(draft: Draft) -> list[str]:
    """Return the channels of the nearest model for which no column is proposed."""
    present = {guess.channel for guess in draft.guesses} | {*draft.constant}
    return [name for name in WANTED.get(draft.nearest, WANTED[""]) if name not in present]


def constant_words(draft: Draft) -> str:
    """Return a sentence on the columns that are left out because they never move; empty without
    any.
    """
    columns = ", ".join(draft.constant.values())
    return f"Left out, since they never move: {columns}" if columns else ""


def _examples(draft: Draft) -> list[str]:
    """Return comments with examples of lines for missing channels, from columns of the file."""
    missing = missing_channels(draft)
    pulses = [name for name in draft.unused if SERVO_PULSES.fullmatch(name)]
    if draft.model == "multirotor":
        return [f'# {missing[0]} = {{column = "(RCOU.C1 - 1500) / 500"}}']
    surfaces = [name for name in missing if name in SURFACES]
    if pulses and surfaces:
        moving = [name for name in pulses if name in draft.moving] or pulses
        servos = {name: pulses[SERVO_ORDER.get(name, 0) % len(pulses)] for name in surfaces}
        return [f'# {name} = "pwm({servo}, 1500, 573)"' for name, servo in servos.items()] + [
            "# pwm(column, pulse at zero, us per radian): 573 where 10 us move the surface by 1 "
            "deg. Pulses that move: " + ", ".join(moving) + ".",
            "# SERVOn_FUNCTION in the log's parameters says which surface a channel moves; for "
            "elevons take",
            f'# elevator = "0.5*(pwm({moving[0]}, 1500, 573) + pwm({moving[-1]}, 1500, 573))"',
        ]
    sign, channel = ("-", missing[0]) if draft.nearest == "lateral" else ("+", "elevator")
    return [f'# {channel} = {{column = "0.5*(elevon_left {sign} elevon_right)", unit = "deg"}}']


def unused_words(draft: Draft) -> str:
    """Return a sentence on the columns of a table for which no channel is proposed."""
    return f"Columns without a channel: {', '.join(draft.unused)}"


def _sweep_comments(file: RecordFile) -> list[str]:
    """Return comments with the command for a sweep of ArduPilot's SYSID mode; else an empty list.

    The output is the angular rate that moves most.
    """
    for topic in topics_of(file):
        columns = {name: i for i, name in enumerate(topic.table.header)}
        rates = [name for name in ("Gx", "Gy", "Gz") if name in columns]
        if topic.name != "SIDD" or "Targ" not in columns or not rates:
            continue
        ranges = {name: np.ptp(numbers(topic.table, columns[name]).values) for name in rates}
        rate = max(ranges, key=lambda name: ranges[name])
        path = file.path.name
        return [
            "# A sweep of ArduPilot's SYSID mode. Its frequency response:",
            f"# flightid response {path} --input SIDD.Targ --output SIDD.{rate} --out bode",
        ]
    return []


# ---- Drafts of vehicle files

ORIGIN_OF_INERTIA = ": swing test, CAD, or mass * (share of the length)^2 (docs, your recorder)"


def vehicle_text(draft: Draft) -> str:
    """Return a draft of the vehicle file; numbers that the record lacks are comments."""
    model = draft.nearest or "rigid"
    templates = tomllib.loads(
        files("scenarios.preparation").joinpath("vehicle_drafts.toml").read_text(encoding="utf-8")
    )
    if model in templates:
        found = {guess.channel for guess in draft.guesses if not guess.fault}
        surfaces = [name for name in ("elevator", "aileron", "rudder") if name in found]
        return str(templates[model]).format(
            name=toml_string(draft.file.path.stem),
            surfaces="\n".join(f'{name} = "rad"' for name in surfaces),
            thrust="thrust" if "thrust" in found else "none",
            aileron='# "aileron" = ...\n' if "aileron" in found else "",
            rudder='# "rudder" = ...\n' if "rudder" in found else "",
        )
    speed = next(
        (
            0.5 * (guess.least + guess.most)
            for guess in draft.guesses
            if guess.channel == "airspeed" and not guess.fault
        ),
        None,
    )
    key = "reference_airspeed" if model == "longitudinal" else "airspeed"
    known = (
        f"{key} = {speed:.4g}  # m/s, the middle of the recorded range"
        if speed
        else f"# {key} = ...  # m/s"
    )
    length, inertias = "chord", ["pitch_inertia"]
    if model == "lateral":
        length, inertias = "span", ["roll_inertia", "yaw_inertia", "cross_inertia"]
    further = {
        "lateral": ["# trim_alpha = ...  # rad", "# trim_theta = ...  # rad"],
        "longitudinal": ["# thrust_arm = ...  # m, above the centre of gravity"],
    }.get(model, [])
    lines = [
        f"# Draft of a vehicle file for --model {model}. Take the # from each line and give its "
        "number.",
        f"name = {toml_string(draft.file.path.stem)}",
        '# aircraft_class = ...  # "I" light, "II" medium, "III" large, "IV" fighter (MIL-F-8785C)',
        '# flight_phase = ...  # "A" rapid maneuvers, "B" gradual ones, "C" approach and landing',
        '# mass = ...  # kg, or a text with a unit: mass = "24200 lb"',
        "# wing_area = ...  # m2",
        f"# {length} = ...  # m",
        *(f"# {name} = ...  # kg m2{ORIGIN_OF_INERTIA}" for name in inertias),
        known,
        "# air_density = ...  # kg/m3 at the height of the flight",
        *further,
        "[derivatives]  # where the search starts; 30 % wrong will do: from a wind tunnel, DATCOM, "
        "AVL or a similar aircraft",
    ]
    return "\n".join([*lines, *(f"# {name} = ..." for name in _DERIVATIVES[model])]) + "\n"


_DERIVATIVES = {
    "rigid": ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"),
    "longitudinal": (
        "CD_0", "CD_V", "CD_alpha", "CL_0", "CL_V", "CL_alpha", "CL_q", "CL_de", "Cm_0", "Cm_V", "Cm_alpha", "Cm_q", "Cm_de",  # noqa: E501
    ),
    "lateral": (
        "CY_beta", "CY_p", "CY_r", "CY_da", "CY_dr", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr", "Cn_beta", "Cn_p", "Cn_r", "Cn_da", "Cn_dr",  # noqa: E501
    ),
}  # fmt: skip


# ---- Drafts of a record, printed or written

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
