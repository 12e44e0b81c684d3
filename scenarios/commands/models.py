"""`flightid models`: the models that there are, or one of them in full; of a user's file also what it can be asked before there is a record."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

from scenarios.api.libraries import TITLES
from scenarios.files.own_models import is_model_file, read_own_model
from scenarios.files.vehicles import MODELS, refuse_unknown_model
from scenarios.terminal.paragraphs import wrapped
from sim.declaration.effect import Signal, Station
from sim.errors import DeclarationError, ModelError

if TYPE_CHECKING:
    from sim.declaration.model import Equations, Model

SAME = 1e-12  # relative, of a call with arrays to single ones: rounding
NEAR = 1e-5  # of complex steps to differences, whose own error is smaller


def show_models(name: str | None) -> None:
    """All models, one line each, or one in full."""
    if name is None:
        width = max(len(each) for each in MODELS)
        for each in MODELS:
            print(f"{each:{width}}  {TITLES.get(each, '')}".rstrip())
        return
    refuse_unknown_model(name, "flightid models")
    if not is_model_file(name):
        equations, constants, derivatives = _built_in(name)
        print(f"{name}: {TITLES[name]}\n\n{(sys.modules[type(equations).__module__].__doc__ or '').strip()}\n")
        _print_equations(equations, constants.items(), derivatives.items())
        return
    own = read_own_model(name, MODELS)
    items = own.model.parameters
    text = getattr(own.model.equations, "explanation", "")
    print(f"{own.model.name}: the model of {own.identity.name}\n" + (f"\n{text}\n" if text else ""))
    held, free = ([(item.name, f"{item.value:g} {item.unit}") for item in items if item.free is wanted] for wanted in (False, True))
    _print_equations(own.model.equations, held, free, own.model)
    print()
    print_checks(own.model)


def show_example(name: str | None) -> None:
    """The file of the scenario ``own-model`` as it stands, so that ``flightid models --example > my_model.py`` makes a copy to edit."""
    if name is not None:
        raise DeclarationError(f"a model is named as well, {name!r}", where="--example", remedy="leave one of the two out")
    print(files("scenarios").joinpath("catalog", "own_model.py").read_text(encoding="utf-8"), end="")


def _built_in(name: str) -> tuple[Equations, Mapping[str, str], Mapping[str, str]]:
    """Equations of a model, and names with units of its constants and of what is estimated."""
    from sim.vehicles.factory import FAMILIES, MODE_CONSTANTS, mode_units

    if name != "flexible":
        return FAMILIES[name]
    equations, constants, derivatives = FAMILIES["rigid"]
    modal = {full: unit for full, unit, _ in mode_units(1)}
    held = {full: unit for full, unit in modal.items() if full.rstrip("1") in MODE_CONSTANTS}
    return equations, {**constants, **held}, {**derivatives, **{full: unit for full, unit in modal.items() if full not in held}}


def _print_equations(
    equations: Equations, constants: Iterable[tuple[str, str]], parameters: Iterable[tuple[str, str]], own: Model | None = None
) -> None:
    from scenarios.diagnosis.candidates import can_act
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
    return [f"{signal.name} ({signal.unit}{', ' + signal.meaning if signal.meaning else ''})" for signal in signals]


def _print_block(heading: str, entries: Sequence[str]) -> None:
    lines = wrapped(", ".join(entries) or "none", 100)
    print("\n".join(f"{heading if first else '':14} {line.strip()}" for first, line in zip([True, *[False] * len(lines)], lines, strict=False)))


def print_checks(model: Model) -> None:
    """What a user's model can be asked before there is a record. Raises ModelError where arrays or complex steps do not pass through it."""
    from scenarios.identification.own_model.model_checks import SHAPE, excited, one_by_one, steps_against_differences, unknown_units

    labels = unknown_units(model)
    print("units: " + (f"no conversion for {', '.join(labels)}: columns of a record carry the same or none" if labels else "all known"))
    apart = one_by_one(model)
    print(f"arrays of shape {SHAPE} against single numbers: {apart:.1g} apart")
    if not apart <= SAME:
        raise ModelError(f"a call with arrays differs from single ones by {apart:.1g}", where=f"model {model.name}", remedy=_ELEMENTARY)
    apart = steps_against_differences(model)
    print(f"complex steps against differences: {apart:.1g} apart")
    if not apart <= NEAR:
        raise ModelError(f"complex steps differ from differences by {apart:.1g}", where=f"model {model.name}", remedy=_ELEMENTARY)
    motion, found = excited(model)
    units = {signal.name: signal.unit for signal in model.equations.inputs}
    flown = " and ".join(f"{name} {size:.3g} {units[name]}" for name, size in motion.amplitudes.items()) or "none"
    cut = ", cut short where it leaves all measure" if motion.ran_away else ""
    print(f"\nexample: doublets of {motion.pulse:.3g} s to each side on {flown}, {motion.end:.3g} s{cut}; noise 1 % of each output's largest move")
    for one in found:
        if one.sigma < float("inf"):
            share = f"known to {100.0 * one.sigma / abs(one.value):.2g} %" if one.value else f"known to {one.sigma:.2g}"
        else:
            share = f"not told from {', '.join(one.beside)}" if one.beside else "moves no output"
        print(f"  {one.name:14} {share}")


_ELEMENTARY = "write it with the functions of sim.maths, each run by itself"
