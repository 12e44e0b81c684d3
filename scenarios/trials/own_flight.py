"""Flights of a user model from options of the command line: maneuvers, noise and hidden effects.

The options become the document of a scenario file, which is then processed as any scenario.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.files.aircraft_files import read_model_file
from scenarios.files.declarations import closest, read_toml_source, refuse_unknown
from scenarios.files.sources import DocumentError, toml_value
from scenarios.files.user_models import inputs_at_rest, own_numbers, unit_in
from scenarios.files.vehicles import MODELS, refuse_unknown_model, with_priors
from scenarios.identification.model_checks import PULSES_BETWEEN_DOUBLETS, Motion, doublet_motion
from scenarios.preparation.declared_model import (
    RESOLVED_STEP_SHARE,
    root_sizes,
    sub_step_of_user_model,
)
from scenarios.studies.declaration import KINDS, ManeuverPlan, maneuver_of
from scenarios.studies.estimating import FIT_STEP
from scenarios.studies.schema import positive_si, si
from scenarios.trials.planted_declaration import find_term
from scenarios.trials.planted_flights import off
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.effects.library import effects_for
from sim.errors import DeclarationError, ModelError

# ---- Maneuvers

LENGTHS = {"3-2-1-1": 7.0, "doublet": 2.0, "pulse": 1.0}  # in units
LONG_MANEUVER_LENGTH = 2.0 * PULSES_BETWEEN_DOUBLETS  # half doublets, of a sweep or a multisine
# of all inputs together: from one over the length of a multisine to about the roots' frequencies
HARMONICS = 8
SWEEP_START_RATIO = 0.2  # lowest frequency of a sweep, share of the frequency of a doublet
SWEEP_END_RATIO = 2.0  # highest such frequency


def maneuver_words(
    words: Sequence[str], model: Model, motion: Motion, pulse: float
) -> tuple[tuple[dict[str, Any], ...], float]:
    """Return the maneuvers in the form of a scenario file, and the time when the last one ends, s.

    Each word is ``INPUT=KIND``, followed by ``,KEY=VALUE`` for entries that differ from the
    defaults. Those are the amplitudes of the example of ``flightid models``, units of ``pulse``
    (s), and one maneuver after the other.

    Raises
    ------
    DeclarationError : an unknown input, kind or key, a wrong value or unit; the word is named.
    """
    maneuvers, end = [], 0.0
    for place, word in enumerate(words):
        where = f"--input {word}"
        name, kind, given = _parts(word, where)
        if name not in motion.amplitudes:
            available = ", ".join(motion.amplitudes) or "none"
            raise DeclarationError(
                f"there is no input {name!r}", where=where, remedy=f"its inputs are {available}"
            )
        refuse_unknown("maneuver", kind, KINDS, where)
        needed = KINDS[kind][0]
        numbers = {
            **_default_numbers(needed, motion.amplitudes[name], pulse, place, len(words)),
            **_numbers(given, unit_in(model, name), where),
        }
        try:
            maneuver_of(ManeuverPlan(name, kind, numbers), where)
        except ModelError as fault:
            raise DeclarationError(fault.what, where=where, remedy=fault.remedy) from None
        length = numbers.get(
            "duration", LENGTHS.get(kind, PULSES_BETWEEN_DOUBLETS) * numbers.get("unit", pulse)
        )
        end = max(end, numbers["start"] + length)
        maneuvers.append({"input": name, "kind": kind, **numbers})
    return tuple(maneuvers), end


def noise_of(words: Sequence[str], model: Model) -> dict[str, float]:
    """Return the standard deviations by output from words ``OUTPUT=SIZE``.

    Raises DeclarationError as ``maneuver_words``.
    """
    outputs, std = [signal.name for signal in model.equations.outputs], {}
    for word in words:
        where = f"--noise {word}"
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals:
            raise DeclarationError(
                "this is not OUTPUT=SIZE",
                where=where,
                remedy=f"write for example --noise {outputs[0]}=0.1",
            )
        refuse_unknown("output", name, outputs, where)
        std[name] = positive_si(_value(text), unit_in(model, name), where)
    return std


def hidden_of(words: Sequence[str], model: Model) -> list[dict[str, Any]]:
    """Return hidden effects in the form of a scenario file.

    Words are ``EFFECT.PARAMETER=VALUE``, or ``EFFECT`` for typical values.

    Raises
    ------
    DeclarationError : an unknown effect or parameter, a wrong value or unit.
    """
    hidden: dict[str, dict[str, float]] = {}
    for word in words:
        where = f"--hide {word}"
        full, equals, text = word.partition("=")
        name, _, key = full.rpartition(".") if equals else (full, "", "")
        names = {effect.name for effect in effects_for(model.equations)}
        if name not in names and not name.startswith("own:"):
            remedy = (
                closest(name, sorted(names))
                if name
                else "write EFFECT.PARAMETER=VALUE, for example sensor-delay:NAME.delay=0.1"
            )
            raise DeclarationError(
                f"there is no effect {name!r} on {model.name}", where=where, remedy=remedy
            )
        items = {item.name: item for item in find_term(name, model.equations, where).parameters}
        values = hidden.setdefault(name, {item.name: item.value for item in items.values()})
        if equals:
            if key not in items:
                raise DeclarationError(
                    f"{name} has no {key!r}", where=where, remedy=closest(key, items)
                )
            values[key] = si(_value(text), items[key].unit, where)
    return [{"name": name, "values": values} for name, values in hidden.items()]


def _parts(word: str, where: str) -> tuple[str, str, dict[str, Any]]:
    """Return input, kind, and the values by key of a word."""
    pieces = _split(word)
    name, equals, kind = (text.strip() for text in pieces[0].partition("="))
    given = {}
    for piece in pieces[1:]:
        key, separator, text = (part.strip() for part in piece.partition("="))
        if not separator:
            raise DeclarationError(
                f"{piece.strip()!r} is not KEY=VALUE",
                where=where,
                remedy="write for example amplitude=0.1",
            )
        given[key] = _value(text)
    if not equals:
        raise DeclarationError(
            "this is not INPUT=KIND",
            where=where,
            remedy="write for example --input NAME=doublet,amplitude=0.1",
        )
    return name, kind, given


def _split(word: str) -> list[str]:
    """Return the parts of a word between commas; commas within brackets do not separate."""
    pieces, depth = [""], 0
    for letter in word:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth <= 0:
            pieces.append("")
        else:
            pieces[-1] += letter
    return pieces


def _value(text: str) -> Any:
    try:
        return toml_value(f"value = {text}")["value"]
    except DocumentError:
        return text.strip()


def _default_numbers(
    needed: Sequence[str], amplitude: float, pulse: float, place: int, count: int
) -> dict[str, Any]:
    """Return the default numbers of maneuver ``place`` of ``count``; ``pulse``: half a doublet, s.

    Inputs move one after the other; multisines have separate harmonics.
    """
    defaults = {
        "amplitude": amplitude,
        "unit": pulse,
        "duration": LONG_MANEUVER_LENGTH * pulse,
        "first_frequency": SWEEP_START_RATIO * math.pi / pulse,
        "last_frequency": SWEEP_END_RATIO * math.pi / pulse,
        "harmonics": [*range(1 + place, 1 + max(HARMONICS, 2 * count), count)],
    }
    return {
        **{key: defaults[key] for key in needed},
        "start": (1.0 + PULSES_BETWEEN_DOUBLETS * place) * pulse,
    }


def _numbers(given: Mapping[str, Any], unit: str, where: str) -> dict[str, Any]:
    """Return the numbers of a maneuver in the units of a scenario: the input's, s, rad/s."""
    units = {"amplitude": unit, "first_frequency": "rad/s", "last_frequency": "rad/s"}
    out: dict[str, Any] = {}
    for key, value in given.items():
        if key == "harmonics":
            if not isinstance(value, list) or not all(isinstance(entry, int) for entry in value):
                raise DeclarationError(
                    f"harmonics={value!r} is no list", where=where, remedy="write harmonics=[1,3,5]"
                )
            out[key] = value
        elif isinstance(value, bool) or not isinstance(value, float | int | str):
            raise DeclarationError(
                f"{key}={value!r} is no number",
                where=where,
                remedy="give a number, or one with a unit",
            )
        else:
            out[key] = si(value, units.get(key, "s"), f"{where}, {key}")
            if not math.isfinite(out[key]):
                raise DeclarationError(
                    f"{key}={value} is no finite number", where=where, remedy="give a finite number"
                )
    return out


# ---- A flight of a user model from options of the command line

NOISE_SHARE = 0.01  # noise over the largest response to doublets
SAMPLES_PER_HALF_DOUBLET = 20.0
# Steps of the truth between two samples, and in a step that resolves the fastest root.
TRUTH_STEPS_PER_SAMPLE = 5.0
SETTLING_TIME = 6.0  # half doublets after the last maneuver
PREDICTED_RECORD_SHARE = 0.8  # amplitude and length of the predicted record's maneuvers
STARTING_ERROR_SHARE = 0.3  # relative error of starting values, as in tracing scenarios
FILTER_PASSES = 5  # passes of a filter, since one pass depends on starting values so far off
FILTER_PRIOR_FACTOR = 20.0
# Integration steps of the truth. More take minutes and some hundred megabytes.
MOST_STEPS = 2e6


@dataclass(frozen=True)
class OwnFlight:
    """Options of a command: model file, file of true values, and texts as typed.

    None and empty use defaults that suit the model.
    """

    model: str
    vehicle: Path | None = None
    inputs: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    duration: float | None = None
    rate: float | None = None


@dataclass(frozen=True, eq=False)
class _Planned:
    """A model with its true values, and its flight."""

    model: Model
    values: Mapping[str, float]
    maneuvers: tuple[dict[str, Any], ...]
    noise: Mapping[str, float]
    duration: float
    rate: float
    step: float


def trace_document(request: OwnFlight) -> dict[str, Any]:
    """Return the document of a scenario with two records and hidden effects in both.

    The maneuvers of the second record are a fifth smaller and shorter.

    Raises
    ------
    DeclarationError : an error in the files or in the texts.
    """
    plan = _planned(request)
    hidden = hidden_of(request.hidden, plan.model)
    second = [dict(maneuver) for maneuver in plan.maneuvers]
    for maneuver in second:
        if "amplitude" in maneuver:
            maneuver["amplitude"] *= PREDICTED_RECORD_SHARE
        if "unit" in maneuver:
            samples = max(1.0, round(PREDICTED_RECORD_SHARE * maneuver["unit"] * plan.rate))
            maneuver["unit"] = samples / plan.rate
    return {
        **_head(plan.model),
        "kind": "trace",
        "distance": "effect missing" if hidden else "nothing missing",
        "flight": {
            **_flight_content(request, plan),
            "train": {"duration": plan.duration, "maneuvers": list(plan.maneuvers)},
            "validate": {"duration": plan.duration, "maneuvers": second},
        },
        "hidden": hidden,
        "estimate": {"model": request.model, "wrong": STARTING_ERROR_SHARE},
        "expect": {
            "verdicts": ["traced", "ambiguous"] if hidden else ["consistent"],
            "effects": [[effect["name"] for effect in hidden]] if hidden else [],
        },
    }


def study_document(request: OwnFlight) -> dict[str, Any]:
    """Return the document of a scenario with one record, estimated from wrong starting values.

    Raises DeclarationError as ``trace_document``.
    """
    plan = _planned(request)
    wrong = {
        item.name: off(item, STARTING_ERROR_SHARE * (-1.0) ** i)
        for i, item in enumerate(item for item in plan.model.parameters if item.free)
    }
    started = with_priors(plan.model.with_values(wrong), list(wrong)).parameters
    return {
        **_head(plan.model),
        "distance": "same equations, finer step",
        "flight": {
            **_flight_content(request, plan),
            "duration": plan.duration,
            "maneuvers": list(plan.maneuvers),
        },
        "estimate": {
            "label": "output error",
            "model": request.model,
            "method": "output-error",
            "passes": FILTER_PASSES,
            "spread": FILTER_PRIOR_FACTOR,
            "max_step": sub_step_of_user_model(plan.model, 1.0 / plan.rate, FIT_STEP),
            "start": {
                name: {"value": started[name].value, "std": started[name].prior_std}
                for name in wrong
            },
        },
    }


def _head(model: Model) -> dict[str, Any]:
    return {
        "schema": "flightid/scenario/1",
        "title": f"{model.name}, a model of one's own",
        "seed": 1,
    }


def _flight_content(request: OwnFlight, plan: _Planned) -> dict[str, Any]:
    return {
        "vehicle": request.model,
        "values": dict(plan.values),
        "rate": plan.rate,
        "step": plan.step,
        "noise_std": dict(plan.noise),
    }


def _planned(request: OwnFlight) -> _Planned:
    refuse_unknown_model(request.model, "--model")
    if request.model in MODELS:
        remedy = (
            f"name one of its scenarios (flightid list), or a file of your own: {request.model} "
            "flies with a vehicle's numbers"
        )
        raise DeclarationError(
            f"the model {request.model!r} is built in", where="--model", remedy=remedy
        )
    for option, value in (("--duration", request.duration), ("--rate", request.rate)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DeclarationError(
                f"{value:g} is not above 0", where=option, remedy="give a positive number"
            )
    own = read_model_file(request.model, MODELS)
    model = (
        own.model
        if request.vehicle is None
        else own_numbers(own, read_toml_source(request.vehicle))[1]
    )
    motion = doublet_motion(model)
    rate = request.rate or _round_up(SAMPLES_PER_HALF_DOUBLET / motion.pulse)
    pulse = max(1.0, round(motion.pulse * rate)) / rate
    words = request.inputs or tuple(f"{name}=doublet" for name in motion.amplitudes)
    maneuvers, end = maneuver_words(words, model, motion, pulse)
    natural = min(
        end + SETTLING_TIME * pulse,
        motion.end if motion.ran_away and not request.inputs else math.inf,
    )
    duration = request.duration or max(2.0, math.ceil(natural * rate - 1e-9)) / rate
    if maneuvers and min(maneuver["start"] for maneuver in maneuvers) >= duration:
        raise DeclarationError(
            f"no maneuver begins within {duration:g} s",
            where="--duration",
            remedy="give a longer one, or --input with a start",
        )
    noise = {**_default_noise(model, motion), **noise_of(request.noise, model)}
    if not noise:
        raise DeclarationError(
            "no output moves",
            where="--noise",
            remedy="name the outputs that are measured, --noise NAME=SIZE",
        )
    values = (
        {item.name: item.value for item in model.parameters} if request.vehicle is not None else {}
    )
    step = _true_step(model, rate)
    if duration / step > MOST_STEPS:
        what = f"{duration:.3g} s in steps of {step:.2g} s are {duration / step:.1g} steps"
        raise DeclarationError(
            what,
            where="--duration, --rate",
            remedy="fly a shorter record, or fewer samples a second",
        )
    return _Planned(model, values, maneuvers, noise, duration, rate, step)


def _default_noise(model: Model, motion: Motion) -> dict[str, float]:
    """Return noise of ``NOISE_SHARE`` of the largest response to doublets, by output."""
    outputs = (signal.name for signal in model.equations.outputs)
    return {
        name: float(f"{NOISE_SHARE * size:.2g}")
        for name, size in zip(outputs, motion.sizes, strict=True)
        if size > 0.0
    }


def _true_step(model: Model, rate: float) -> float:
    """Return the integration step of the truth, s: a fraction of the step of a fit."""
    sizes = root_sizes(compile_model(model), inputs_at_rest(model))
    resolved = RESOLVED_STEP_SHARE / float(max(sizes)) if len(sizes) else math.inf
    longest = max(resolved, sub_step_of_user_model(model, 1.0 / rate, FIT_STEP))
    return min(1.0 / rate, longest) / TRUTH_STEPS_PER_SAMPLE


def _round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10, 20 ... that is not below the value."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(
        float(f"{decade * digit:.1g}")
        for digit in (1.0, 2.0, 5.0, 10.0)
        if decade * digit >= value * (1.0 - 1e-9)
    )
