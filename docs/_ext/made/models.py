"""Pages of the built-in models, and of every name that they declare."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from docs._ext.made.markdown import cell, code, plain_block, table

if TYPE_CHECKING:
    from sim.declaration.effect import Signal
    from sim.declaration.model import Equations

Families = Mapping[str, tuple["Equations", Mapping[str, str], Mapping[str, str]]]


# Parts of the nomenclature that hold the equations of each model.
EQUATIONS = {
    "rigid": "Rigid aircraft",
    "loes": "Low-order equivalent system",
    "ballistic": "Falling body",
    "lateral": "Lateral motion",
    "longitudinal": "Longitudinal motion with airspeed",
    "flexible": "Flexible aircraft",
}
NOMENCLATURE = Path(__file__).parents[2] / "nomenclature.md"


def equations_of(model: str) -> str:
    """The displayed equations under a model's heading in the nomenclature; empty for a model that it does not have."""  # noqa: E501
    if model not in EQUATIONS:
        return ""
    part = (
        NOMENCLATURE.read_text(encoding="utf-8")
        .split(f"\n## {EQUATIONS[model]}\n")[1]
        .split("\n## ")[0]
    )
    return "\n\n".join(re.findall(r"^\$\$.+?\$\$", part, re.MULTILINE | re.DOTALL)) + "\n"


def families() -> Families:
    """Equations by name, with units of constants and of what is estimated."""
    from sim.vehicles.factory import FAMILIES

    return FAMILIES


def models_page() -> str:
    """Every model: equations, signals, constants, parameters, ports, and the effects that may act on it."""  # noqa: E501
    from sim.declaration.effect import Station
    from sim.effects.library import effects_for

    parts = [
        "# Models\n",
        "Made from the declared equations; `flightid models NAME` prints one. `flexible` is `rigid` with elastic modes, each of them the effect "  # noqa: E501
        "`elastic-mode` of a declared mode. Symbols and signs: [nomenclature](../nomenclature.md). One of your own: [how](../own-models.md).\n",  # noqa: E501
    ]
    for name, (equations, constants, derivatives) in families().items():
        parts += [
            f"## {name}\n",
            equations_of(name),
            plain_block(
                getattr(equations, "explanation", "")
                or sys.modules[type(equations).__module__].__doc__
                or ""
            ),
        ]
        for title, signals in (
            ("states", equations.states),
            ("inputs", equations.inputs),
            ("outputs", equations.outputs),
            ("ports", equations.ports),
        ):
            parts.append(signals_table(title, signals))
        parts += [
            units_table("constant, held", constants),
            units_table("parameter, estimated", derivatives),
        ]
        effects = effects_for(equations)
        rows = []
        for station in Station:
            names = dict.fromkeys(effect.name for effect in effects if effect.station is station)
            rows.append([station.value, ", ".join(map(code, names))])
        parts.append(
            table(["station", "effects that may act on it"], (row for row in rows if row[1]))
        )
    parts += [
        "## flexible\n",
        "The rigid aircraft with elastic modes that load it and that it loads.\n",
        equations_of("flexible"),
    ]
    return "\n".join(parts)


def signals_of(equations: Equations) -> tuple[tuple[str, Sequence[Signal]], ...]:
    """The signals that equations declare, by what they are."""
    return (
        ("state", equations.states),
        ("input", equations.inputs),
        ("output", equations.outputs),
        ("port", equations.ports),
    )


def signals_table(title: str, signals: Sequence[Signal]) -> str:
    rows = [[code(signal.name), cell(signal.unit), cell(signal.meaning)] for signal in signals]
    return table([title, "unit", "meaning"], rows) if rows else f"No {title}s.\n"


def units_table(title: str, units: Mapping[str, str]) -> str:
    return table([title, "unit"], ([code(name), cell(unit)] for name, unit in units.items()))


def names_page() -> str:
    """Every signal, constant and parameter of all models in one alphabetical table."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for model, kind, name, unit, meaning in declared():
        entry = found.setdefault((name, unit), {"kind": kind, "meaning": meaning, "models": model})
        entry["meaning"] = entry["meaning"] or meaning
        if kind not in entry["kind"].split(", "):
            entry["kind"] += f", {kind}"
        if model not in entry["models"].split(", "):
            entry["models"] += f", {model}"
    rows = (
        [code(name), cell(unit), cell(entry["meaning"]), cell(entry["kind"]), cell(entry["models"])]
        for (name, unit), entry in sorted(
            found.items(), key=lambda item: (item[0][0].lower(), item[0])
        )
    )
    return "\n".join(
        [
            "# Names and units\n",
            "Every signal, constant and parameter that the built-in models declare, made from the declarations. Symbols, signs and equations: "  # noqa: E501
            "[nomenclature](../nomenclature.md).\n",
            table(["name", "unit", "meaning", "what it is", "of models"], rows),
        ]
    )


def declared() -> Iterator[tuple[str, str, str, str, str]]:
    """Model, kind, name, unit, meaning of everything that is declared."""
    for model, (equations, constants, derivatives) in families().items():
        for kind, signals in signals_of(equations):
            for signal in signals:
                yield model, kind, signal.name, signal.unit, signal.meaning
        for kind, units in (("constant", constants), ("parameter", derivatives)):
            for name, unit in units.items():
                yield model, kind, name, unit, ""
