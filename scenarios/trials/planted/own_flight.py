"""A flight of a user's own model as a command line asks it: maneuvers, noise and hidden effects in words, the rest as the model's roots suggest.

What is made is the document of a scenario, as its file would have it, so that everything behind it is that of scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.files.declarations import read_toml_source
from scenarios.files.user_models import inputs_at_rest, own_numbers, read_own_model
from scenarios.files.vehicles import MODELS, refuse_unknown_model, with_priors
from scenarios.identification.model_checks import Motion, doublet_motion
from scenarios.preparation.declared_model import RESOLVED, root_sizes, step_of
from scenarios.trials.planted.flights import off
from scenarios.trials.planted.own_words import hidden_of, maneuver_words, noise_of
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import DeclarationError

NOISE = 0.01  # of an output's largest move under doublets
SAMPLES = 20.0  # in half a doublet, at least
FINER = 5.0  # steps of the truth between two samples, and halves of the step that resolves the quickest root
SETTLING = 6.0  # half doublets behind the last maneuver
SMALLER = 0.8  # of amplitude and length, maneuvers of the record that is predicted
WRONG = 0.3  # share by which starts are off, as in tracing scenarios
PASSES, SPREAD = 5, 20.0  # of a filter, if one is chosen: from starts so far off a single pass believes its first slopes
MOST_STEPS = 2e6  # of the truth, whose states and outputs are kept at all of them: minutes, and some hundred megabytes
FIT_STEP = 0.01  # s, the longest of a fit where an own model does not ask for another


@dataclass(frozen=True)
class OwnFlight:
    """What a command line asks: the model's file, the file of its true values, and texts as typed; None and empty leave it to the model."""

    model: str
    vehicle: Path | None = None
    inputs: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    duration: float | None = None
    rate: float | None = None


@dataclass(frozen=True, eq=False)
class _Planned:
    """The model at its true values, and the flight of it."""

    model: Model
    values: Mapping[str, float]
    maneuvers: tuple[dict[str, Any], ...]
    noise: Mapping[str, float]
    duration: float
    rate: float
    step: float


def trace_document(asked: OwnFlight) -> dict[str, Any]:
    """Two records, the second of maneuvers by a fifth smaller and shorter, with what is hidden in both.

    Raises
    ------
    DeclarationError : anything wrong in the files or in the texts, in one line.
    """
    plan = _planned(asked)
    hidden = hidden_of(asked.hidden, plan.model)
    second = [{**each, **{key: SMALLER * each[key] for key in ("amplitude",) if key in each}} for each in plan.maneuvers]
    for each in second:
        if "unit" in each:
            each["unit"] = max(1.0, round(SMALLER * each["unit"] * plan.rate)) / plan.rate
    return {
        **_head(plan.model),
        "kind": "trace",
        "distance": "effect missing" if hidden else "nothing missing",
        "flight": {
            **_common(asked, plan),
            "train": {"duration": plan.duration, "maneuvers": list(plan.maneuvers)},
            "validate": {"duration": plan.duration, "maneuvers": second},
        },
        "hidden": hidden,
        "estimate": {"model": asked.model, "wrong": WRONG},
        "expect": {"verdicts": ["traced", "ambiguous"] if hidden else ["consistent"], "effects": [[each["name"] for each in hidden]] * bool(hidden)},
    }


def study_document(asked: OwnFlight) -> dict[str, Any]:
    """One record estimated by output error from starts that are off. Raises as ``trace_document``."""
    plan = _planned(asked)
    wrong = {item.name: off(item, WRONG * (-1.0) ** i) for i, item in enumerate(item for item in plan.model.parameters if item.free)}
    started = with_priors(plan.model.with_values(wrong), list(wrong)).parameters
    return {
        **_head(plan.model),
        "distance": "same equations, finer step",
        "flight": {**_common(asked, plan), "duration": plan.duration, "maneuvers": list(plan.maneuvers)},
        "estimate": {
            "label": "output error",
            "model": asked.model,
            "method": "output-error",
            "passes": PASSES,
            "spread": SPREAD,
            "max_step": step_of(plan.model, 1.0 / plan.rate, FIT_STEP),
            "start": {name: {"value": started[name].value, "std": started[name].prior_std} for name in wrong},
        },
    }


def _head(model: Model) -> dict[str, Any]:
    return {"schema": "flightid/scenario/1", "title": f"{model.name}, a model of one's own", "seed": 1}


def _common(asked: OwnFlight, plan: _Planned) -> dict[str, Any]:
    return {"vehicle": asked.model, "values": dict(plan.values), "rate": plan.rate, "step": plan.step, "noise_std": dict(plan.noise)}


def _planned(asked: OwnFlight) -> _Planned:
    refuse_unknown_model(asked.model, "--model")
    if asked.model in MODELS:
        remedy = f"name one of its scenarios (flightid list), or a file of your own: {asked.model} flies with a vehicle's numbers"
        raise DeclarationError(f"the model {asked.model!r} is built in", where="--model", remedy=remedy)
    for option, value in (("--duration", asked.duration), ("--rate", asked.rate)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DeclarationError(f"{value:g} is not above 0", where=option, remedy="give a positive number")
    own = read_own_model(asked.model, MODELS)
    model = own.model if asked.vehicle is None else own_numbers(own, read_toml_source(asked.vehicle))[1]
    motion = doublet_motion(model)
    rate = asked.rate or _round_up(SAMPLES / motion.pulse)
    pulse = max(1.0, round(motion.pulse * rate)) / rate
    words = asked.inputs or tuple(f"{name}=doublet" for name in motion.amplitudes)
    maneuvers, end = maneuver_words(words, model, motion, pulse)
    natural = min(end + SETTLING * pulse, motion.end if motion.ran_away and not asked.inputs else math.inf)
    duration = asked.duration or max(2.0, math.ceil(natural * rate - 1e-9)) / rate
    if maneuvers and min(each["start"] for each in maneuvers) >= duration:
        raise DeclarationError(f"no maneuver begins within {duration:g} s", where="--duration", remedy="give a longer one, or --input with a start")
    noise = {**_usual_noise(model, motion), **noise_of(asked.noise, model)}
    if not noise:
        raise DeclarationError("no output moves", where="--noise", remedy="name the outputs that are measured, --noise NAME=SIZE")
    values = {item.name: item.value for item in model.parameters} if asked.vehicle is not None else {}
    step = _true_step(model, rate)
    if duration / step > MOST_STEPS:
        what = f"{duration:.3g} s in steps of {step:.2g} s are {duration / step:.1g} steps"
        raise DeclarationError(what, where="--duration, --rate", remedy="fly a shorter record, or fewer samples a second")
    return _Planned(model, values, maneuvers, noise, duration, rate, step)


def _usual_noise(model: Model, motion: Motion) -> dict[str, float]:
    outputs = (signal.name for signal in model.equations.outputs)
    return {name: float(f"{NOISE * size:.2g}") for name, size in zip(outputs, motion.sizes, strict=True) if size > 0.0}


def _true_step(model: Model, rate: float) -> float:
    """Integration step of the truth, s: finer than a fit's, which resolves the quickest root or takes a hundredth of a second."""
    sizes = root_sizes(compile_model(model), inputs_at_rest(model))
    quick = RESOLVED / float(max(sizes)) if len(sizes) else math.inf
    return min(1.0 / rate, max(quick, step_of(model, 1.0 / rate, FIT_STEP))) / FINER


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, 20 ... that is not below."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{decade * digit:.1g}") for digit in (1.0, 2.0, 5.0, 10.0) if decade * digit >= value * (1.0 - 1e-9))
