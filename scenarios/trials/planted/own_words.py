"""Maneuvers, noise and hidden effects of an own model as they are typed: ``current=doublet,amplitude=2 A``, ``angle=0.1 deg``, ``NAME.KEY=VALUE``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.files.declarations import closest
from scenarios.files.sources import DocumentError, toml_value
from scenarios.files.user_models import unit_in
from scenarios.identification.model_checks import BETWEEN, Motion
from scenarios.studies.declaration import ManeuverPlan
from scenarios.studies.estimating import KINDS, maneuver_of
from scenarios.studies.schema import positive, si
from scenarios.trials.planted.hiding import find_term
from sim.declaration.model import Model
from sim.effects.library import effects_for
from sim.errors import DeclarationError, ModelError

LENGTHS = {"3-2-1-1": 7.0, "doublet": 2.0, "pulse": 1.0}  # in units
LONG = 2.0 * BETWEEN  # half doublets, of a sweep or a multisine
HARMONICS = 8  # of all inputs together: from one over the length of a multisine to about the roots' frequencies
SLOWEST, FASTEST = 0.2, 2.0  # of the frequency of a doublet, of a sweep


def maneuver_words(words: Sequence[str], model: Model, motion: Motion, pulse: float) -> tuple[tuple[dict[str, Any], ...], float]:
    """Maneuvers as a scenario's file has them, in the inputs' units, and the time at which the last one ends, s.

    Each word is ``INPUT=KIND``, then ``,KEY=VALUE`` for what is not as the example of ``flightid models`` would have it: the amplitude that this
    takes, units of ``pulse`` (s), and one maneuver after the other.

    Raises
    ------
    DeclarationError : an input, a kind or a key that there is not, a wrong value or unit: the word is named.
    """
    out, end = [], 0.0
    for place, word in enumerate(words):
        where = f"--input {word}"
        name, kind, given = _parts(word, where)
        if name not in motion.amplitudes:
            known = ", ".join(motion.amplitudes) or "none"
            raise DeclarationError(f"there is no input {name!r}", where=where, remedy=f"its inputs are {known}")
        if kind not in KINDS:
            raise DeclarationError(f"there is no maneuver {kind!r}", where=where, remedy=closest(kind, KINDS))
        needed = KINDS[kind][0]
        numbers = {**_usual(needed, motion.amplitudes[name], pulse, place, len(words)), **_numbers(given, unit_in(model, name), where)}
        try:
            maneuver_of(ManeuverPlan(name, kind, numbers), where)
        except ModelError as fault:
            raise DeclarationError(fault.what, where=where, remedy=fault.remedy) from None
        length = numbers.get("duration", LENGTHS.get(kind, BETWEEN) * numbers.get("unit", pulse))
        end = max(end, numbers["start"] + length)
        out.append({"input": name, "kind": kind, **numbers})
    return tuple(out), end


def noise_of(words: Sequence[str], model: Model) -> dict[str, float]:
    """Standard deviations by output, ``OUTPUT=SIZE``. Raises DeclarationError as ``maneuver_words``."""
    outputs, out = [signal.name for signal in model.equations.outputs], {}
    for word in words:
        where = f"--noise {word}"
        name, equals, text = word.partition("=")
        if not equals:
            raise DeclarationError("this is not OUTPUT=SIZE", where=where, remedy=f"write for example --noise {outputs[0]}=0.1")
        if name.strip() not in outputs:
            raise DeclarationError(f"there is no output {name.strip()!r}", where=where, remedy=closest(name.strip(), outputs))
        out[name.strip()] = positive(si(_value(text), unit_in(model, name.strip()), where), where)
    return out


def hidden_of(words: Sequence[str], model: Model) -> list[dict[str, Any]]:
    """What is hidden, as a scenario's file has it: ``EFFECT.PARAMETER=VALUE``, or ``EFFECT`` alone at its typical values.

    Raises
    ------
    DeclarationError : no such effect on this model, no such parameter, a wrong value or unit.
    """
    found: dict[str, dict[str, float]] = {}
    for word in words:
        where = f"--hide {word}"
        full, equals, text = word.partition("=")
        name, _, key = full.rpartition(".") if equals else (full, "", "")
        names = {effect.name for effect in effects_for(model.equations)}
        if name not in names and not name.startswith("own:"):
            remedy = closest(name, sorted(names)) if name else "write EFFECT.PARAMETER=VALUE, for example sensor-delay:NAME.delay=0.1"
            raise DeclarationError(f"there is no effect {name!r} on {model.name}", where=where, remedy=remedy)
        items = {item.name: item for item in find_term(name, model.equations, where).parameters}
        values = found.setdefault(name, {each.name: each.value for each in items.values()})
        if equals:
            if key not in items:
                raise DeclarationError(f"{name} has no {key!r}", where=where, remedy=closest(key, items))
            values[key] = si(_value(text), items[key].unit, where)
    return [{"name": name, "values": values} for name, values in found.items()]


def _parts(word: str, where: str) -> tuple[str, str, dict[str, Any]]:
    """Input, kind, and the keys behind them."""
    pieces = _split(word)
    name, equals, kind = (text.strip() for text in pieces[0].partition("="))
    given = {}
    for piece in pieces[1:]:
        key, sign, text = (each.strip() for each in piece.partition("="))
        if not sign:
            raise DeclarationError(f"{piece.strip()!r} is not KEY=VALUE", where=where, remedy="write for example amplitude=0.1")
        given[key] = _value(text)
    if not equals:
        raise DeclarationError("this is not INPUT=KIND", where=where, remedy="write for example --input NAME=doublet,amplitude=0.1")
    return name, kind, given


def _split(word: str) -> list[str]:
    """Pieces between commas, those inside of brackets left together."""
    pieces, depth = [""], 0
    for letter in word:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth <= 0:
            pieces.append("")
        else:
            pieces[-1] += letter
    return pieces


def _value(text: str) -> Any:
    """What a value says: a number, a list, or a text with a unit."""
    try:
        return toml_value(f"value = {text}")["value"]
    except DocumentError:
        return text.strip()


def _usual(needed: Sequence[str], amplitude: float, pulse: float, place: int, count: int) -> dict[str, Any]:
    """What a maneuver needs, as the roots suggest; inputs one after the other, of multisines each with harmonics of its own."""
    usual = {
        "amplitude": amplitude,
        "unit": pulse,
        "duration": LONG * pulse,
        "first_frequency": SLOWEST * math.pi / pulse,
        "last_frequency": FASTEST * math.pi / pulse,
        "harmonics": [*range(1 + place, 1 + max(HARMONICS, 2 * count), count)],
    }
    return {**{key: usual[key] for key in needed}, "start": (1.0 + BETWEEN * place) * pulse}


def _numbers(given: Mapping[str, Any], unit: str, where: str) -> dict[str, Any]:
    """Numbers of a maneuver in the units of a scenario: the input's, s, rad/s."""
    units = {"amplitude": unit, "first_frequency": "rad/s", "last_frequency": "rad/s"}
    out: dict[str, Any] = {}
    for key, value in given.items():
        if key == "harmonics":
            if not isinstance(value, list) or not all(isinstance(each, int) for each in value):
                raise DeclarationError(f"harmonics={value!r} is no list", where=where, remedy="write harmonics=[1,3,5]")
            out[key] = value
        elif isinstance(value, bool) or not isinstance(value, float | int | str):
            raise DeclarationError(f"{key}={value!r} is no number", where=where, remedy="give a number, or one with a unit")
        else:
            out[key] = si(value, units.get(key, "s"), f"{where}, {key}")
            if not math.isfinite(out[key]):
                raise DeclarationError(f"{key}={value} is no finite number", where=where, remedy="give a finite number")
    return out
