"""Drafts of a channel map and of a vehicle file as TOML.

A channel map has a line for each channel, and comments on missing channels and unused columns. A
vehicle file has the numbers that the record shows; other numbers are comments.
"""

from __future__ import annotations

import json
import textwrap

import numpy as np

from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import RecordFile
from scenarios.preparation.drafting import (
    COMMANDS,
    SERVO_PULSES,
    SURFACES,
    Draft,
    topics_of,
)

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
        column = choice.column if isinstance(choice.column, int) else quoted(choice.column)
        entry = str(column)
        if guess.command and not guess.fault:
            entry = f'{{column = {quoted(f"THROW * {choice.column}")}, unit = "deg"}}'
        elif choice.unit is not None:
            entry = f"{{column = {column}, unit = {quoted(choice.unit)}}}"
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


def quoted(text: str) -> str:
    """Return a text as a TOML string."""
    return json.dumps(text, ensure_ascii=False)


# ---- Drafts of vehicle files

ORIGIN_OF_INERTIA = ": swing test, CAD, or mass * (share of the length)^2 (docs, your recorder)"


def vehicle_text(draft: Draft) -> str:
    """Return a draft of the vehicle file; numbers that the record lacks are comments."""
    model = draft.nearest or "rigid"
    if model == "ballistic":
        return _BALLISTIC.format(name=quoted(draft.file.path.stem))
    if model == "multirotor":
        return _MULTIROTOR.format(name=quoted(draft.file.path.stem))
    if model == "aircraft":
        found = {guess.channel for guess in draft.guesses if not guess.fault}
        return _AIRCRAFT.format(
            name=quoted(draft.file.path.stem),
            surfaces="\n".join(
                f'{name} = "rad"' for name in ("elevator", "aileron", "rudder") if name in found
            ),
            thrust="thrust" if "thrust" in found else "none",
            **{
                name: f'# "{name}" = ...\n' if name in found else ""
                for name in ("aileron", "rudder")
            },
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
        f"name = {quoted(draft.file.path.stem)}",
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


_BALLISTIC = """# Draft of a vehicle file for --model ballistic. Take the # from each line and give its number.
name = {name}
# air_density_reference = ...  # kg/m3 at altitude 0; 1.225 at sea level
# density_scale_height = ...  # m; 8500 near the ground
gravity = 9.80665  # m/s2
[derivatives]  # where the search starts
# beta = ...  # kg/m2: mass / (drag coefficient * area)
"""  # noqa: E501
_AIRCRAFT = """# Draft of a vehicle file for --model aircraft. Take the # from each line and give its number.
model = "aircraft"
name = {name}
# mass = ...  # kg, or a text with a unit: mass = "17.6 t"
# wing_area = ...  # m2
# chord = ...  # m
# span = ...  # m
# roll_inertia = ...  # kg m2
# pitch_inertia = ...  # kg m2
# yaw_inertia = ...  # kg m2
# cross_inertia = ...  # kg m2
# air_density = ...  # kg/m3 at the height of the flight
# airspeed = ...  # m/s, a typical one
[surfaces]
{surfaces}
[thrust]
input = "{thrust}"  # "thrust" where the record has it, in N; else "none"
[aerodynamics.CD]  # terms and where the search starts; 30 % wrong will do
# "1" = ...
# "alpha" = ...
[aerodynamics.CY]
# "beta" = ...
{rudder}[aerodynamics.CL]
# "1" = ...
# "alpha" = ...
# "elevator" = ...
[aerodynamics.Cl]
# "beta" = ...
# "p" = ...
# "r" = ...
{aileron}[aerodynamics.Cm]
# "1" = ...
# "alpha" = ...
# "q" = ...
# "elevator" = ...
[aerodynamics.Cn]
# "beta" = ...
# "r" = ...
{rudder}"""  # noqa: E501
_MULTIROTOR = """# Draft of a vehicle file for --model multirotor: usual sizes for commands from -1 to 1.
name = {name}
[derivatives]  # where the search starts; what is left out is held at zero
L_p = -1.0  # 1/s, roll damping
L_lat = 60.0  # rad/s2, roll acceleration at full command
L_0 = 0.0  # rad/s2, that a steady command balances
M_q = -1.0
M_lon = 60.0
M_0 = 0.0
N_r = -0.5
N_ped = 10.0
N_0 = 0.0
Z_col = -20.0  # m/s2, specific force (down) at full thrust
Z_0 = 0.0
motor_time_constant = 0.04  # s
delay = 0.01  # s, from command to motor
"""  # noqa: E501
_DERIVATIVES = {
    "rigid": ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"),
    "longitudinal": (
        "CD_0", "CD_V", "CD_alpha", "CL_0", "CL_V", "CL_alpha", "CL_q", "CL_de", "Cm_0", "Cm_V", "Cm_alpha", "Cm_q", "Cm_de",  # noqa: E501
    ),
    "lateral": (
        "CY_beta", "CY_p", "CY_r", "CY_da", "CY_dr", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr", "Cn_beta", "Cn_p", "Cn_r", "Cn_da", "Cn_dr",  # noqa: E501
    ),
}  # fmt: skip
