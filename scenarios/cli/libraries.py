"""Work of the commands on libraries: list and show effects, vehicles, models and labs."""

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

from scenarios.api.tables import TITLES, model_family
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
from sim.errors import DeclarationError, ModelError

if TYPE_CHECKING:
    from sim.declaration.effect import Effect, Signal
    from sim.declaration.model import Equations, Model


# ---- flightid effects and flightid vehicles

LIST_WIDTH = 80  # characters of a line in a list
WIDEST = 100  # most characters of a line of text or of a table
UNLIMITED = 1e9  # SI; a bound of at least this size stands for no bound


CATCH_ALL_TERM = (
    "This is a catch-all term, not an effect of the library. It stands for causes outside the "
    "library and competes with the effects in a diagnosis: if it is the most probable, the verdict "
    "is unexplained. It is never named as a cause."
)


def show_effects(name: str | None) -> None:
    """Print one line for each effect, or the effect ``name`` in full."""
    if name is None:
        _list_effects()
        return
    from sim.declaration.proposal import Refinable, Traceable

    effect, renaming = _effect_of_any_model(name)
    if renaming:
        print(renaming)
    width = min(terminal_width(), WIDEST)
    if isinstance(effect, Traceable) and effect.traits.guard:
        print("\n".join([*folded(CATCH_ALL_TERM, width), ""]))
    absent = ", ".join(f"{key} = {value:g}" for key, value in effect.absent.items())
    lines = [
        f"{effect.name}  ({effect.station.value})",
        "",
        *folded(" ".join(effect.explanation.split()), width),
        "",
        *folded(f"absent when {absent}; {effect.regularity.value}", width),
    ]
    if effect.aliases:
        lines += folded(f"hard to tell from {', '.join(effect.aliases)}", width)
    lines += ["", "parameters:", *table_lines(_parameter_columns(effect), width=width)]
    if isinstance(effect, Refinable):
        names = {item.name for item in effect.parameters}
        added = [
            f"{item.name} ({item.unit})" if item.unit != "1" else item.name
            for item in effect.finer().parameters
            if item.name not in names
        ]
        sentence = (
            "a refined form, which is tried if this form is found, has the further parameters "
            f"{', '.join(added)}"
        )
        lines += ["", *folded(sentence, width)]
    print("\n".join(lines))


def _list_effects() -> None:
    """Print name, station and first clause of the explanation of each effect."""
    from sim.effects.library import effect_names, find_effect

    names = effect_names()
    width = max(len(name) for name in names)
    for name in names:
        effect = find_effect(name)
        start = f"{name:{width}}  {effect.station.value:11}  "
        clause = " ".join(effect.explanation.split()).split(". ")[0].split(": ")[0].rstrip(".")
        print(start + textwrap.shorten(clause, LIST_WIDTH - len(start), placeholder=" ..."))


def _parameter_columns(effect: Effect) -> list[TableColumn]:
    from scenarios.report.quantities import shown_in, unit_cell

    units = [shown_in(item.unit, item.name) for item in effect.parameters]
    items = [(item, factor) for item, (factor, _) in zip(effect.parameters, units, strict=True)]
    return [
        TableColumn("parameter", [item.name for item in effect.parameters], left=True),
        TableColumn("unit", [unit_cell(unit) for _, unit in units], left=True),
        TableColumn("start", [f"{factor * item.value:.3g}" for item, factor in items]),
        TableColumn("range", [_range_text(item.bounds, factor) for item, factor in items]),
        TableColumn(
            "plausible", [_plausible_range(effect, item.name, factor) for item, factor in items]
        ),
    ]


def _effect_of_any_model(name: str) -> tuple[Effect, str]:
    """Return the effect with a name, and a sentence if the effect has another name on its model.

    The effect is one of the library, one that a model makes for its inputs, channels, loads and
    derivatives, or a catch-all term of a model.
    """
    from sim.effects.library import (
        catch_all_terms_for,
        effect_names,
        effects_for,
        find_effect,
        other_names,
    )
    from sim.vehicles.factory import FAMILIES

    if name in effect_names():
        return find_effect(name), ""
    for equations, _, _ in FAMILIES.values():
        own_name = other_names(equations).get(name, name)
        for effect in (*effects_for(equations), *catch_all_terms_for(equations)):
            if effect.name != own_name:
                continue
            if own_name == name:
                return effect, ""
            return effect, f"{name} is named {own_name} on the model {equations.name}"
    return find_effect(name), ""


def show_vehicles(name: str | None, other: str | None) -> None:
    """Print one line for each vehicle, all numbers of one, or the differences of two vehicles."""
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
        width = max(len(vehicle) for vehicle in names)
        for vehicle in names:
            print(f"{vehicle:{width}}  {read_parameter_set(vehicle).title}")
        return
    data, out = read_parameter_set(name), console()
    if other is None:
        print_paragraph(out, f"{name}: {data.title}", 0)
        print_paragraph(out, data.source, 0)
        numbers = (*data.numbers, *data.initial)
        columns = [
            TableColumn("parameter", [number.name for number in numbers], left=True),
            TableColumn("value", [f"{number.value:.7g}" for number in numbers]),
            TableColumn("unit", [number.unit for number in numbers], left=True),
            TableColumn("as printed", [number.printed for number in numbers], left=True),
            TableColumn("origin", [number.source for number in numbers], left=True),
        ]
        print_table(out, "", columns)
        return
    rows = []
    for change in difference(data, read_parameter_set(other)):
        pair = (change.first, change.second)
        unit = next(number.unit for number in pair if number is not None)
        values = ["-" if number is None else f"{number.value:.7g}" for number in pair]
        rows.append((change.name, unit, *values))
    columns = columns_of(("parameter", "unit", name, other), rows, left=2)
    print_table(out, f"{name} against {other}", columns)


def _range_text(bounds: tuple[float, float], factor: float) -> str:
    """Return the bounds of a parameter, times ``factor``; empty without bounds."""
    low, high = (
        factor * end if abs(end) < UNLIMITED else math.copysign(math.inf, end) for end in bounds
    )
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.4g} to {high:.4g}"
    if math.isfinite(low):
        return f"from {low:.4g} up"
    return f"up to {high:.4g}" if math.isfinite(high) else ""


def _plausible_range(effect: Effect, name: str, factor: float) -> str:
    """Return the plausible range of a parameter, times ``factor``; empty if the effect declares
    none.
    """
    from sim.declaration.proposal import Traceable

    ranges = effect.traits.plausible if isinstance(effect, Traceable) else {}
    if name not in ranges:
        return ""
    low, high = ranges[name]
    return f"{factor * low:.4g} to {factor * high:.4g}"


# ---- flightid models

ARRAY_TOLERANCE = 1e-12  # relative difference of array and scalar calls: rounding
SLOPE_TOLERANCE = 1e-5  # relative difference of complex-step and finite-difference derivatives


def show_models(name: str | None) -> None:
    """Print one line for each model, or the model ``name`` in full."""
    from scenarios.files.aircraft_files import read_model_file
    from scenarios.files.user_models import is_model_file
    from scenarios.files.vehicles import MODELS, refuse_unknown_model

    if name is None:
        width = max(len(model) for model in MODELS)
        for model in MODELS:
            print(f"{model:{width}}  {TITLES.get(model, '')}".rstrip())
        return
    refuse_unknown_model(name, "flightid models")
    if not is_model_file(name):
        equations, constant_units, parameter_units = _built_in_model(name)
        print(f"{name}: {TITLES[name]}\n\n{_explanation(equations)}\n")
        _print_equations(equations, constant_units.items(), parameter_units.items())
        return
    file = read_model_file(name, MODELS)
    items = file.model.parameters
    explanation = getattr(file.model.equations, "explanation", "")
    print(f"{file.model.name}: the model of {file.identity.name}\n")
    if explanation:
        print(f"{explanation}\n")
    constants, parameters = (
        [(item.name, f"{item.value:g} {item.unit}") for item in items if item.free is free]
        for free in (False, True)
    )
    _print_equations(file.model.equations, constants, parameters, file.model)
    print()
    print_checks(file.model)


def _explanation(equations: Equations) -> str:
    """Return the explanation of equations: their attribute ``explanation``, else the docstring of
    their module.
    """
    from scenarios.files.vehicles import AIRCRAFT

    if text := getattr(equations, "explanation", ""):
        return str(text)
    module = type(equations).__module__
    if equations.name == AIRCRAFT:
        module = "sim.vehicles.aircraft"
    return (sys.modules[module].__doc__ or "").strip()


def show_example(name: str | None) -> None:
    """Print an example of a model file, for ``flightid models --example > my_model.py``."""
    if name is not None:
        raise DeclarationError(
            f"a model is named as well, {name!r}",
            where="--example",
            remedy="leave one of the two out",
        )
    print(
        files("scenarios").joinpath("catalog", "own_model.py").read_text(encoding="utf-8"), end=""
    )


def _built_in_model(name: str) -> tuple[Equations, Mapping[str, str], Mapping[str, str]]:
    """Return the equations of a built-in model, and the units of its constants and parameters."""
    from sim.vehicles.factory import MODE_CONSTANTS, mode_units

    if name != "flexible":
        return model_family(name)
    # The flexible model is the rigid one with elastic modes; mode 1 stands for all.
    equations, rigid_constants, derivatives = model_family("rigid")
    modal = {parameter: unit for parameter, unit, _ in mode_units(1)}
    mode_constants = {
        parameter: unit
        for parameter, unit in modal.items()
        if parameter.rstrip("1") in MODE_CONSTANTS
    }
    mode_derivatives = {
        parameter: unit for parameter, unit in modal.items() if parameter not in mode_constants
    }
    return equations, {**rigid_constants, **mode_constants}, {**derivatives, **mode_derivatives}


def _print_equations(
    equations: Equations,
    constants: Iterable[tuple[str, str]],
    parameters: Iterable[tuple[str, str]],
    user_model: Model | None = None,
) -> None:
    """Print the signals and parameters of a model, and the effects that can act on it.

    ``constants`` and ``parameters`` are pairs of a name and its unit, or its value with unit.
    """
    from scenarios.diagnosis.opening import can_act
    from sim.declaration.effect import Station
    from sim.effects.library import effects_for, other_names

    effects = effects_for(equations)
    if user_model is not None:
        effects = can_act(effects, user_model)
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
        aliases = [f"{alias} is {effect}" for alias, effect in others.items()]
        _print_block("  other names", aliases)


def _signals(signals: Sequence[Signal]) -> list[str]:
    return [
        f"{signal.name} ({signal.unit}{', ' + signal.meaning if signal.meaning else ''})"
        for signal in signals
    ]


def _print_block(heading: str, entries: Sequence[str]) -> None:
    """Print the entries beside a heading, which only the first line has."""
    for i, line in enumerate(wrapped(", ".join(entries) or "none", WIDEST)):
        print(f"{heading if i == 0 else '':14} {line.strip()}")


def print_checks(model: Model) -> None:
    """Print the checks of a user's model that need no record.

    Raises
    ------
    ModelError : the model cannot be computed with arrays or with complex steps.
    """
    from scenarios.identification.model_checks import (
        SHAPE,
        excited,
        one_by_one,
        steps_against_differences,
        unknown_units,
    )

    labels = unknown_units(model)
    if labels:
        print(
            f"units: no conversion for {', '.join(labels)}: columns of a record must have the same "
            "unit or none"
        )
    else:
        print("units: all known")
    difference = one_by_one(model)
    print(f"arrays of shape {SHAPE} against single numbers: relative difference {difference:.1g}")
    if not difference <= ARRAY_TOLERANCE:  # NaN fails, too
        raise ModelError(
            f"a call with arrays differs from single ones by {difference:.1g}",
            where=f"model {model.name}",
            remedy=_USE_SIM_MATHS,
        )
    difference = steps_against_differences(model)
    print(f"complex steps against finite differences: relative difference {difference:.1g}")
    if not difference <= SLOPE_TOLERANCE:  # NaN fails, too
        raise ModelError(
            f"complex steps differ from finite differences by {difference:.1g}",
            where=f"model {model.name}",
            remedy=_USE_SIM_MATHS,
        )
    motion, precisions = excited(model)
    units = {signal.name: signal.unit for signal in model.equations.inputs}
    amplitudes = [f"{name} {size:.3g} {units[name]}" for name, size in motion.amplitudes.items()]
    cut = ", ended where the motion diverges" if motion.ran_away else ""
    print(
        f"\nexample: doublets of {motion.pulse:.3g} s to each side on "
        f"{' and '.join(amplitudes) or 'none'}, {motion.end:.3g} "
        f"s{cut}; noise 1 % of each output's largest change"
    )
    for parameter in precisions:
        if not parameter.sigma < math.inf:
            text = "moves no output"
            if parameter.beside:
                text = f"not distinguishable from {', '.join(parameter.beside)}"
        elif parameter.value:
            text = f"known to {100.0 * parameter.sigma / abs(parameter.value):.2g} %"
        else:
            text = f"known to {parameter.sigma:.2g}"
        print(f"  {parameter.name:14} {text}")


_USE_SIM_MATHS = (
    "write the equations with the functions of sim.maths, which take arrays and complex numbers"
)


# ---- flightid lab: list, open and copy teaching notebooks, and print their keys

_FILE = re.compile(r"lab(\d+)_\w+\.py")
_TITLE = re.compile(r'app_title="Lab \d+: ([^"]+)"')
_HOST = "127.0.0.1"  # a notebook runs code, so only this machine may reach it


def lab_files() -> dict[int, Path]:
    """Return the notebooks by their number, in order."""
    with as_file(files("flightid.labs")) as folder:
        notebooks = {
            int(match[1]): path
            for path in folder.iterdir()
            if (match := _FILE.fullmatch(path.name))
        }
    return dict(sorted(notebooks.items()))


def title_of(path: Path) -> str:
    """Return the title of a notebook, or its file stem if it has none."""
    match = _TITLE.search(path.read_text(encoding="utf-8"))
    return match[1] if match else path.stem


def list_labs() -> None:
    """Print one line for each lab."""
    for number, path in lab_files().items():
        print(f"{number}  {title_of(path)}")
    print(
        "flightid lab N opens one in the browser; --copy DIR copies it, for changes; --key prints "
        "the instructor's key"
    )


def show_key(number: int) -> None:
    """Print the instructor's key of a lab as Markdown."""
    print(
        (_lab_file(number).parent / "keys" / f"lab{number}.md").read_text(encoding="utf-8"), end=""
    )


def copy_lab(number: int, folder: Path) -> Path:
    """Copy a lab into a folder and return the path of the copy. A missing folder is made.

    Raises
    ------
    DeclarationError : the folder already has a file of this name.
    FlightidError : the file cannot be written.
    """
    from scenarios.files.writing import unwritable

    path = _lab_file(number)
    target = folder / path.name
    if target.exists():
        raise DeclarationError(
            "this file exists, and you may have changed it",
            where=str(target),
            remedy="name another folder",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    except OSError as error:
        raise unwritable(target, error) from None
    print(f"copied to {target}; marimo edit {target} opens it in an editor")
    return target


def open_lab(number: int, edit: bool, port: int | None, browser: bool, folder: Path | None) -> int:
    """Serve a lab to a browser on this machine until it is stopped, and return the exit code.

    Parameters
    ----------
    number : number of the lab.
    edit : open a copy of the lab in an editor; the copy is made if it is missing.
    port : port of the server; None takes a free one.
    browser : open a browser.
    folder : folder of the copy; None takes the current folder.

    Raises
    ------
    DeclarationError : there is no such lab, marimo is not installed, or the port is taken.
    """
    path = _lab_file(number)
    if importlib.util.find_spec("marimo") is None:
        raise DeclarationError(
            "labs are notebooks of marimo, which is not installed",
            where="flightid lab",
            remedy='in the folder of the project: python -m pip install -e ".[labs]"',
        )
    if port is not None:
        _refuse_taken_port(port)
    if edit:
        copy = (folder or Path()) / path.name
        path = copy if copy.exists() else copy_lab(number, folder or Path())
    action = "edit" if edit else "run"
    command = [sys.executable, "-m", "marimo", action, str(path), "--host", _HOST]
    if port is not None:
        command += ["--port", str(port)]
    if not browser:
        command.append("--headless")
    if edit:
        command.append("--skip-update-check")
    try:
        return subprocess.call(command)
    except KeyboardInterrupt:
        return 0


def _lab_file(number: int) -> Path:
    labs = lab_files()
    if number not in labs:
        raise DeclarationError(
            f"there is no lab {number}",
            where="flightid lab",
            remedy=f"use a number from 1 to {max(labs)}",
        )
    return labs[number]


def _refuse_taken_port(port: int) -> None:
    with socket.socket() as probe:
        if probe.connect_ex((_HOST, port)) == 0:
            raise DeclarationError(
                f"port {port} is taken", where="--port", remedy="name another one, or leave it out"
            )
