"""`flightid list`, `flightid effects` and `flightid vehicles`: what there is."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from scenarios.terminal.display_units import shown_in, unit_cell
from scenarios.terminal.paragraphs import folded, print_paragraph, terminal_width
from scenarios.terminal.tables import Column, columns_of, print_table, table_lines

if TYPE_CHECKING:
    from sim.declaration.effect import Effect

COLUMNS = 80  # of a terminal, which a list fits
UNLIMITED = 1e9  # in SI: what effects write for no bound


def list_scenarios() -> None:
    """Scenarios, one line each."""
    from scenarios.studies.catalogue import scenario_names, scenario_title

    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:{width}}  {scenario_title(name)}")


def show_scenario(name: str) -> None:
    """The file of a scenario as it stands, so that ``flightid list rigid > mine.toml`` makes a copy to edit."""
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
            print(start + textwrap.shorten(_first_clause(effect.explanation), COLUMNS - len(start), placeholder=" ..."))
        return
    effect, other = _effect_of_any_model(name)
    if other:
        print(other)
    width = min(terminal_width(), 100)
    absent = f"absent when {', '.join(f'{key} = {value:g}' for key, value in effect.absent.items())}; {effect.regularity.value}"
    alike = folded(f"hard to tell from {', '.join(effect.aliases)}", width) if effect.aliases else []
    lines = [f"{effect.name}  ({effect.station.value})", "", *folded(" ".join(effect.explanation.split()), width), "", *folded(absent, width), *alike]
    lines += ["", "parameters:", *table_lines(_parameters(effect), width=width)]
    if isinstance(effect, Refinable):
        known = {item.name for item in effect.parameters}
        more = [f"{item.name} ({item.unit})" if item.unit != "1" else item.name for item in effect.finer().parameters if item.name not in known]
        lines += ["", *folded(f"a freer form of it, tried where this one is found, adds {', '.join(more)}", width)]
    print("\n".join(lines))


def _parameters(effect: Effect) -> list[Column]:
    """Start, bounds and what is believed without asking, of each parameter."""
    shown = [shown_in(item.unit, item.name) for item in effect.parameters]
    items = list(zip(effect.parameters, shown, strict=True))
    return [
        Column("parameter", [item.name for item in effect.parameters], left=True),
        Column("unit", [unit_cell(unit) for _, unit in shown], left=True),
        Column("start", [f"{factor * item.value:.3g}" for item, (factor, _) in items]),
        Column("range", [_range(item.bounds, factor) for item, (factor, _) in items]),
        Column("plausible", [_believed(effect, item.name, factor) for item, (factor, _) in items]),
    ]


def _effect_of_any_model(name: str) -> tuple[Effect, str]:
    """An effect of the library, or one that is made for the inputs, channels, loads and derivatives of a model; a line where it has another name."""
    from sim.effects.library import effect_names, effects_for, find_effect, other_names
    from sim.vehicles.factory import FAMILIES

    for equations, _, _ in FAMILIES.values() if name not in effect_names() else ():
        own = other_names(equations).get(name, name)
        made = [effect for effect in effects_for(equations) if effect.name == own]
        if made:
            return made[0], f"{name} on {equations.name} is what {own} stands for, and bears that name" if own != name else ""
    return find_effect(name), ""


def show_vehicles(name: str | None, other: str | None) -> None:
    """All vehicles, one number by number, or what differs between two."""
    from scenarios.terminal.numbers import console
    from sim.errors import DeclarationError
    from sim.vehicles.library import difference, read_parameter_set, vehicle_names

    if name is None:
        if other is not None:
            raise DeclarationError("--diff compares two vehicles", where="flightid vehicles", remedy="name one before it")
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
            Column("parameter", [n.name for n in numbers], left=True),
            Column("value", [f"{n.value:.7g}" for n in numbers]),
            Column("unit", [n.unit for n in numbers], left=True),
            Column("as printed", [n.printed for n in numbers], left=True),
            Column("origin", [n.source for n in numbers], left=True),
        ]
        print_table(out, "", columns)
    else:
        rows = []
        for d in difference(data, read_parameter_set(other)):
            there = [each for each in (d.first, d.second) if each is not None]
            rows.append((d.name, there[0].unit, *("-" if each is None else f"{each.value:.7g}" for each in (d.first, d.second))))
        print_table(out, f"{name} against {other}", columns_of(("parameter", "unit", name, other), rows, left=2))


def _first_clause(text: str) -> str:
    return " ".join(text.split()).split(". ")[0].split(": ")[0].rstrip(".")


def _range(bounds: tuple[float, float], factor: float) -> str:
    low, high = (factor * end if abs(end) < UNLIMITED else math.copysign(math.inf, end) for end in bounds)
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.4g} to {high:.4g}"
    return f"from {low:.4g} up" if math.isfinite(low) else f"up to {high:.4g}" if math.isfinite(high) else ""


def _believed(effect: Effect, name: str, factor: float) -> str:
    """The range within which a value is believed without asking."""
    from sim.declaration.proposal import Traceable

    ranges = effect.traits.plausible if isinstance(effect, Traceable) else {}
    return f"{factor * ranges[name][0]:.4g} to {factor * ranges[name][1]:.4g}" if name in ranges else ""
