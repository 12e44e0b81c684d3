"""Work of the commands on libraries: scenarios, effects, vehicles, models, labs."""

from __future__ import annotations

import importlib.util
import math
import re
import shutil
import socket
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.api.tables import TITLES
from scenarios.report.summary import (
    TableColumn,
    columns_of,
    folded,
    print_paragraph,
    print_table,
    table_lines,
    terminal_width,
    wrapped,
)
from sim.errors import DeclarationError, FlightidError, ModelError

if TYPE_CHECKING:
    from sim.declaration.effect import Effect, Signal
    from sim.declaration.model import Equations, Model


# ---- flightid list, flightid effects and flightid vehicles: what there is

TERMINAL_COLUMNS = 80  # width of lists
UNLIMITED = 1e9  # in SI: what effects write for no bound


def list_scenarios() -> None:
    """Scenarios, one line each."""
    from scenarios.studies.catalogue import scenario_names, scenario_title

    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:{width}}  {scenario_title(name)}")


def show_scenario(name: str) -> None:
    """Print a scenario's file unchanged, for ``flightid list rigid > mine.toml``."""
    from scenarios.studies.catalogue import scenario_text

    print(scenario_text(name), end="")


def show_effects(name: str | None) -> None:
    """All effects by station, or one in full."""
    from sim.declaration.proposal import Refinable
    from sim.effects.library import effect_names, find_effect

    if name is None:
        names = effect_names()
        width = max(len(each) for each in names)
        for each in names:
            effect = find_effect(each)
            start = f"{each:{width}}  {effect.station.value:11}  "
            print(
                start
                + textwrap.shorten(
                    _first_clause(effect.explanation),
                    TERMINAL_COLUMNS - len(start),
                    placeholder=" ...",
                )
            )
        return
    effect, other = _effect_of_any_model(name)
    if other:
        print(other)
    width = min(terminal_width(), 100)
    absent = (
        f"absent when {', '.join(f'{key} = {value:g}' for key, value in effect.absent.items())}; "
        f"{effect.regularity.value}"
    )
    alike = (
        folded(f"hard to tell from {', '.join(effect.aliases)}", width) if effect.aliases else []
    )
    lines = [
        f"{effect.name}  ({effect.station.value})",
        "",
        *folded(" ".join(effect.explanation.split()), width),
        "",
        *folded(absent, width),
        *alike,
    ]
    lines += ["", "parameters:", *table_lines(_parameters(effect), width=width)]
    if isinstance(effect, Refinable):
        known = {item.name for item in effect.parameters}
        more = [
            f"{item.name} ({item.unit})" if item.unit != "1" else item.name
            for item in effect.finer().parameters
            if item.name not in known
        ]
        lines += [
            "",
            *folded(
                f"a freer form of it, tried where this one is found, adds {', '.join(more)}", width
            ),
        ]
    print("\n".join(lines))


def _parameters(effect: Effect) -> list[TableColumn]:
    """Return start, bounds and plausible range of each parameter."""
    from scenarios.report.quantities import shown_in, unit_cell

    shown = [shown_in(item.unit, item.name) for item in effect.parameters]
    items = list(zip(effect.parameters, shown, strict=True))
    return [
        TableColumn("parameter", [item.name for item in effect.parameters], left=True),
        TableColumn("unit", [unit_cell(unit) for _, unit in shown], left=True),
        TableColumn("start", [f"{factor * item.value:.3g}" for item, (factor, _) in items]),
        TableColumn("range", [_range(item.bounds, factor) for item, (factor, _) in items]),
        TableColumn(
            "plausible", [_believed(effect, item.name, factor) for item, (factor, _) in items]
        ),
    ]


def _effect_of_any_model(name: str) -> tuple[Effect, str]:
    """Return an effect of the library, or one that is made for the inputs, channels, loads and
    derivatives of a model; a line where it has another name.
    """
    from sim.effects.library import effect_names, effects_for, find_effect, other_names
    from sim.vehicles.factory import FAMILIES

    for equations, _, _ in FAMILIES.values() if name not in effect_names() else ():
        own = other_names(equations).get(name, name)
        made = [effect for effect in effects_for(equations) if effect.name == own]
        if made:
            return (
                made[0],
                f"{name} on {equations.name} is what {own} stands for, and bears that name"
                if own != name
                else "",
            )
    return find_effect(name), ""


def show_vehicles(name: str | None, other: str | None) -> None:
    """All vehicles, one number by number, or what differs between two."""
    from scenarios.report.quantities import console
    from sim.vehicles.library import difference, read_parameter_set, vehicle_names

    if name is None:
        if other is not None:
            raise DeclarationError(
                "--diff compares two vehicles",
                where="flightid vehicles",
                remedy="name one before it",
            )
        names = vehicle_names()
        width = max(map(len, names))
        for each in names:
            print(f"{each:{width}}  {read_parameter_set(each).title}")
        return
    data, out = read_parameter_set(name), console()
    if other is None:
        print_paragraph(out, f"{name}: {data.title}", 0)
        print_paragraph(out, data.source, 0)
        numbers = (*data.numbers, *data.initial)
        columns = [
            TableColumn("parameter", [n.name for n in numbers], left=True),
            TableColumn("value", [f"{n.value:.7g}" for n in numbers]),
            TableColumn("unit", [n.unit for n in numbers], left=True),
            TableColumn("as printed", [n.printed for n in numbers], left=True),
            TableColumn("origin", [n.source for n in numbers], left=True),
        ]
        print_table(out, "", columns)
    else:
        rows = []
        for d in difference(data, read_parameter_set(other)):
            there = [each for each in (d.first, d.second) if each is not None]
            rows.append(
                (
                    d.name,
                    there[0].unit,
                    *("-" if each is None else f"{each.value:.7g}" for each in (d.first, d.second)),
                )
            )
        print_table(
            out,
            f"{name} against {other}",
            columns_of(("parameter", "unit", name, other), rows, left=2),
        )


def _first_clause(text: str) -> str:
    return " ".join(text.split()).split(". ")[0].split(": ")[0].rstrip(".")


def _range(bounds: tuple[float, float], factor: float) -> str:
    low, high = (
        factor * end if abs(end) < UNLIMITED else math.copysign(math.inf, end) for end in bounds
    )
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.4g} to {high:.4g}"
    return (
        f"from {low:.4g} up"
        if math.isfinite(low)
        else f"up to {high:.4g}"
        if math.isfinite(high)
        else ""
    )


def _believed(effect: Effect, name: str, factor: float) -> str:
    """Return the range within which a value is believed without asking."""
    from sim.declaration.proposal import Traceable

    ranges = effect.traits.plausible if isinstance(effect, Traceable) else {}
    return (
        f"{factor * ranges[name][0]:.4g} to {factor * ranges[name][1]:.4g}"
        if name in ranges
        else ""
    )


# ---- flightid models

SAME_VALUE_TOLERANCE = 1e-12  # relative, of a call with arrays to single ones: rounding
SLOPE_TOLERANCE = 1e-5  # between complex steps and differences, whose error is smaller


def show_models(name: str | None) -> None:
    """All models, one line each, or one in full."""
    from scenarios.files.aircraft_files import read_model_file
    from scenarios.files.user_models import is_model_file
    from scenarios.files.vehicles import MODELS, refuse_unknown_model

    if name is None:
        width = max(len(each) for each in MODELS)
        for each in MODELS:
            print(f"{each:{width}}  {TITLES.get(each, '')}".rstrip())
        return
    refuse_unknown_model(name, "flightid models")
    if not is_model_file(name):
        equations, constants, derivatives = _built_in(name)
        print(f"{name}: {TITLES[name]}\n\n{_explanation(equations)}\n")
        _print_equations(equations, constants.items(), derivatives.items())
        return
    own = read_model_file(name, MODELS)
    items = own.model.parameters
    text = getattr(own.model.equations, "explanation", "")
    print(f"{own.model.name}: the model of {own.identity.name}\n" + (f"\n{text}\n" if text else ""))
    held, free = (
        [(item.name, f"{item.value:g} {item.unit}") for item in items if item.free is wanted]
        for wanted in (False, True)
    )
    _print_equations(own.model.equations, held, free, own.model)
    print()
    print_checks(own.model)


def _explanation(equations: Equations) -> str:
    """Return the explanation of the equations: their ``explanation``, or the docstring of their
    file.
    """
    from scenarios.files.vehicles import AIRCRAFT

    if text := getattr(equations, "explanation", ""):
        return str(text)
    own = equations.name == AIRCRAFT
    home = "sim.vehicles.aircraft" if own else type(equations).__module__
    return (sys.modules[home].__doc__ or "").strip()


def show_example(name: str | None) -> None:
    """Print the example of a model file, for ``flightid models --example > my_model.py``."""
    if name is not None:
        raise DeclarationError(
            f"a model is named as well, {name!r}",
            where="--example",
            remedy="leave one of the two out",
        )
    print(
        files("scenarios").joinpath("catalog", "own_model.py").read_text(encoding="utf-8"), end=""
    )


def _built_in(name: str) -> tuple[Equations, Mapping[str, str], Mapping[str, str]]:
    """Return the equations of a model, and its constants and parameters with units."""
    from scenarios.files.aircraft_files import example
    from scenarios.files.vehicles import AIRCRAFT
    from sim.vehicles.factory import FAMILIES, MODE_CONSTANTS, mode_units

    if name == AIRCRAFT:
        model = example()
        held, free = (
            {item.name: item.unit for item in model.parameters if item.free is wanted}
            for wanted in (False, True)
        )
        return model.equations, held, free
    if name != "flexible":
        return FAMILIES[name]
    equations, constants, derivatives = FAMILIES["rigid"]
    modal = {full: unit for full, unit, _ in mode_units(1)}
    held = {full: unit for full, unit in modal.items() if full.rstrip("1") in MODE_CONSTANTS}
    return (
        equations,
        {**constants, **held},
        {**derivatives, **{full: unit for full, unit in modal.items() if full not in held}},
    )


def _print_equations(
    equations: Equations,
    constants: Iterable[tuple[str, str]],
    parameters: Iterable[tuple[str, str]],
    own: Model | None = None,
) -> None:
    from scenarios.diagnosis.opening import can_act
    from sim.declaration.effect import Station
    from sim.effects.library import effects_for, other_names

    effects = effects_for(equations) if own is None else can_act(effects_for(equations), own)
    _print_block("states", _signals(equations.states))
    _print_block("inputs", _signals(equations.inputs))
    _print_block("outputs", _signals(equations.outputs))
    biased = getattr(equations, "biased_outputs", None)
    if biased is not None:
        _print_block("biases", biased)
    _print_block("constants", [f"{name} ({text})" for name, text in constants])
    _print_block("parameters", [f"{name} ({text})" for name, text in parameters])
    _print_block("ports", _signals(equations.ports))
    print("\neffects that may act on it:")
    for station in Station:
        names = list(dict.fromkeys(effect.name for effect in effects if effect.station is station))
        if names:
            _print_block(f"  {station.value}", names)
    others = other_names(equations)
    if others:
        _print_block("  other names", [f"{name} is {own}" for name, own in others.items()])


def _signals(signals: Sequence[Signal]) -> list[str]:
    return [
        f"{signal.name} ({signal.unit}{', ' + signal.meaning if signal.meaning else ''})"
        for signal in signals
    ]


def _print_block(heading: str, entries: Sequence[str]) -> None:
    lines = wrapped(", ".join(entries) or "none", 100)
    print(
        "\n".join(
            f"{heading if first else '':14} {line.strip()}"
            for first, line in zip([True, *[False] * len(lines)], lines, strict=False)
        )
    )


def print_checks(model: Model) -> None:
    """Print the checks of a user model that need no record. Raises ModelError if arrays or
    complex steps do not pass through it.
    """
    from scenarios.identification.model_checks import (
        SHAPE,
        excited,
        one_by_one,
        steps_against_differences,
        unknown_units,
    )

    labels = unknown_units(model)
    print(
        "units: "
        + (
            f"no conversion for {', '.join(labels)}: columns of a record carry the same or none"
            if labels
            else "all known"
        )
    )
    apart = one_by_one(model)
    print(f"arrays of shape {SHAPE} against single numbers: {apart:.1g} apart")
    if not apart <= SAME_VALUE_TOLERANCE:
        raise ModelError(
            f"a call with arrays differs from single ones by {apart:.1g}",
            where=f"model {model.name}",
            remedy=_ELEMENTARY,
        )
    apart = steps_against_differences(model)
    print(f"complex steps against differences: {apart:.1g} apart")
    if not apart <= SLOPE_TOLERANCE:
        raise ModelError(
            f"complex steps differ from differences by {apart:.1g}",
            where=f"model {model.name}",
            remedy=_ELEMENTARY,
        )
    motion, found = excited(model)
    units = {signal.name: signal.unit for signal in model.equations.inputs}
    flown = (
        " and ".join(f"{name} {size:.3g} {units[name]}" for name, size in motion.amplitudes.items())
        or "none"
    )
    cut = ", cut short where it leaves all measure" if motion.ran_away else ""
    print(
        f"\nexample: doublets of {motion.pulse:.3g} s to each side on {flown}, {motion.end:.3g} "
        f"s{cut}; noise 1 % of each output's largest move"
    )
    for one in found:
        if one.sigma < float("inf"):
            share = (
                f"known to {100.0 * one.sigma / abs(one.value):.2g} %"
                if one.value
                else f"known to {one.sigma:.2g}"
            )
        else:
            share = f"not told from {', '.join(one.beside)}" if one.beside else "moves no output"
        print(f"  {one.name:14} {share}")


_ELEMENTARY = "write it with the functions of sim.maths, each run by itself"


# ---- flightid lab: teaching notebooks listed, opened, copied, and their instructor's keys

_FILE = re.compile(r"lab(\d+)_\w+\.py")
_TITLE = re.compile(r'app_title="Lab \d+: ([^"]+)"')
_HOST = "127.0.0.1"  # a notebook runs code: nobody else's browser may reach it


def lab_files() -> dict[int, Path]:
    """Return the notebooks by their number, in order."""
    with as_file(files("flightid.labs")) as folder:
        found = {
            int(match[1]): path
            for path in folder.iterdir()
            if (match := _FILE.fullmatch(path.name))
        }
    return dict(sorted(found.items()))


def title_of(path: Path) -> str:
    """Return the title in a notebook."""
    found = _TITLE.search(path.read_text(encoding="utf-8"))
    return found[1] if found else path.stem


def list_labs() -> None:
    """One line for each lab."""
    for number, path in lab_files().items():
        print(f"{number}  {title_of(path)}")
    print(
        "flightid lab N opens one in the browser; --copy DIR copies it, for changes; --key prints "
        "the instructor's key"
    )


def show_key(number: int) -> None:
    """The instructor's key of a lab, as Markdown."""
    print((_lab(number).parent / "keys" / f"lab{number}.md").read_text(encoding="utf-8"), end="")


def copy_lab(number: int, folder: Path) -> Path:
    """Return a copy of a lab in a folder that is made where it is missing.

    Raises
    ------
    DeclarationError : the folder has one already. FlightidError : it cannot be written.
    """
    path = _lab(number)
    target = folder / path.name
    if target.exists():
        raise DeclarationError(
            "there is such a file already, and it may be yours",
            where=str(target),
            remedy="name another folder",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    except OSError as error:
        raise FlightidError(
            f"cannot be written ({error.strerror})",
            where=str(target),
            remedy="name a folder that you may write in",
        ) from None
    print(f"copied to {target}; marimo edit {target} opens it in an editor")
    return target


def open_lab(number: int, edit: bool, port: int | None, browser: bool, folder: Path | None) -> int:
    """Serve a lab to a browser on this machine until it is stopped, and return the exit code.

    ``edit`` opens the copy in ``folder`` (None: the current one), which is made if it is missing:
    the installed lab stays as it is.

    Raises
    ------
    DeclarationError : there is no such lab, marimo is not installed, or the port is taken.
    """
    path = _lab(number)
    if importlib.util.find_spec("marimo") is None:
        raise DeclarationError(
            "labs are notebooks of marimo, which is not installed",
            where="flightid lab",
            remedy='in the folder of the project: python -m pip install -e ".[labs]"',
        )
    if port is not None:
        _refuse_taken(port)
    if edit:
        own = (folder or Path()) / path.name
        path = own if own.exists() else copy_lab(number, folder or Path())
    command = [
        sys.executable,
        "-m",
        "marimo",
        "edit" if edit else "run",
        str(path),
        "--host",
        _HOST,
    ]
    command += ["--port", str(port)] if port is not None else []
    command += [] if browser else ["--headless"]
    command += ["--skip-update-check"] if edit else []
    try:
        return subprocess.call(command)
    except KeyboardInterrupt:
        return 0


def _lab(number: int) -> Path:
    known = lab_files()
    if number not in known:
        raise DeclarationError(
            f"there is no lab {number}",
            where="flightid lab",
            remedy=f"use a number from 1 to {max(known)}",
        )
    return known[number]


def _refuse_taken(port: int) -> None:
    with socket.socket() as probe:
        if probe.connect_ex((_HOST, port)) == 0:
            raise DeclarationError(
                f"port {port} is taken", where="--port", remedy="name another one, or leave it out"
            )
