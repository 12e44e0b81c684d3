"""A linear model, built in or a user's, fitted to the measured frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from ident.flying_qualities.modes import level_flight, state_space
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.model_fit import ModelFit, fit_model
from ident.frequency_response.transfer_function import BEST, GOOD
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import (
    VehicleFile,
    read_vehicle,
    refuse_unknown_model,
    vehicle_with_file,
)
from scenarios.preparation.declared_model import model_of_file
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    Cell,
    Column,
    Number,
    Table,
    formatted,
    table,
)
from scenarios.report.quantities import number_text
from scenarios.responses.fitting import INSENSITIVE, UNCERTAIN, target_of
from scenarios.responses.reading import Names
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import DeclarationError, ModelError, RecordError

DELAY = "delay"


@dataclass(frozen=True)
class ModelOptions:
    """Which model is fitted: ``model`` its name or file, None fits none; ``vehicle`` its constants
    and starting values; ``fixed`` parameters that are held."""

    model: str | None = None
    vehicle: Path | None = None
    fixed: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model fitted to the responses at ``places`` ``(row, column)``; ``model`` its name,
    ``units`` by parameter, ``sentences`` on what was done, ``file`` the vehicle file that was read.
    """

    model: str
    vehicle: str
    fit: ModelFit
    places: tuple[tuple[int, int], ...]
    pairs: tuple[str, ...]
    units: Mapping[str, str]
    omegas: tuple[np.ndarray, ...]
    sentences: tuple[str, ...]
    file: InputFile | None = None

    def of(self, row: int, column: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Frequencies, rad/s, and response of the fitted model; None where it was not fitted."""
        if (row, column) not in self.places:
            return None
        at = self.places.index((row, column))
        return self.omegas[at], self.fit.responses[at]

    @property
    def cautions(self) -> tuple[str, ...]:
        """What a user should know, one sentence each."""
        fit, out = self.fit, []
        if not fit.converged:
            out.append(f"the search for the parameters of {self.model} did not end")
        for name, cost in zip(self.pairs, fit.costs, strict=True):
            if cost > GOOD:
                said = f"above {GOOD:g}: it does not fit"
                out.append(f"{name}: cost {cost:.3g} of {self.model}, {said}")
        size = np.maximum(np.abs(fit.values), 1e-300)
        weak = (fit.cramer_rao > UNCERTAIN * size) | (fit.insensitivity > INSENSITIVE * size)
        named = [name for name, each in zip(fit.names, weak.tolist(), strict=True) if each]
        if named:
            limits = f"{100 * UNCERTAIN:.0f} % and insensitivity {100 * INSENSITIVE:.0f} %"
            out.append(
                f"{', '.join(named)} hardly determined (Cramer-Rao bound {limits}); hold one of "
                "them with --fix"
            )
        return tuple(out)


def model_fit_of(
    found: FrequencyResponses, names: Names, options: ModelOptions, held: float | None = None
) -> FittedModel | None:
    """Fit the model to all responses that have a usable band; None where none is named.

    The model is linearised about rest, or about level flight where it has one, which stays where
    the starting values have it. A delay of all inputs is free unless it is fixed. ``held`` : s, of
    inputs that are held so long and whose hold was taken out of the responses: an output that the
    input moves at once does not lag by the hold, so that the model is sampled like the record.

    Raises
    ------
    DeclarationError, RecordError : signals that the model has not, nothing usable, in one line.
    """
    if options.model is None:
        if options.vehicle is not None:
            raise DeclarationError("no model is named", where="--vehicle", remedy="add --model M")
        return None
    refuse_unknown_model(options.model, "--model")
    vehicle = read_vehicle(options.vehicle, options.model)
    system = compile_model(model_of_file(vehicle))
    _refuse_other_signals(system, names)
    places, targets, pairs = [], [], []
    for row, output in enumerate(names.outputs):
        for column, one in enumerate(names.inputs):
            if np.count_nonzero(found.usable[row, column]) >= 3:
                name = f"{output}/{one}"
                places.append((row, column))
                pairs.append(name)
                targets.append(target_of(found, (row, column), name))
    if not targets:
        what = "no response has a usable band to fit"
        raise RecordError(what, where="--model", remedy="lower --coherence, or leave it out")
    declared = system.parameters.values()
    trim = level_flight(system, declared)
    x0, u0 = trim if trim is not None else (None, None)
    inputs = [system.input_names.index(names.inputs[column]) for _, column in places]
    outputs = [system.output_names.index(names.outputs[row]) for row, _ in places]

    def responses(values: Mapping[str, float]) -> list[np.ndarray]:
        space = state_space(system, values, x0, u0)
        late = values.get(DELAY, 0.0)
        eye, out = np.eye(len(space.A)), []
        A, B = space.A, space.B
        if held is not None:
            # Phi and Gamma of a step over which the inputs are held.
            n, r = B.shape
            both = np.zeros((n + r, n + r))
            both[:n, :n], both[:n, n:] = A, B
            whole = expm(held * both)
            A, B = whole[:n, :n], whole[:n, n:]
        for target, k, m in zip(targets, outputs, inputs, strict=True):
            s = 1j * target.omega
            z = s if held is None else np.exp(s * held)
            inside = np.linalg.solve(z[:, None, None] * eye - A, B[None, :, m, None])
            row = (space.C[k] @ inside)[:, 0] + space.D[k, m]
            between = 1.0 if held is None else (1.0 - np.exp(-s * held)) / (s * held)
            out.append(row * np.exp(-s * late) / between)
        return out

    start, fixed = _starts(system, options.fixed or {})
    try:
        fit = fit_model(targets, responses, start, fixed, {DELAY: 0.0})
    except ModelError as error:
        raise DeclarationError(error.what, where="--model", remedy=error.remedy) from None
    units = {name: system.parameters[name].unit for name in (*start, *fixed) if name != DELAY}
    units |= {DELAY: "s"}
    about = "level flight" if trim is not None else "rest"
    return FittedModel(
        options.model,
        vehicle.name,
        fit,
        tuple(places),
        tuple(pairs),
        units,
        tuple(target.omega for target in targets),
        (_fitted(options.model, vehicle, about, len(pairs)),),
        vehicle.identity,
    )


def _fitted(model: str, vehicle: VehicleFile, about: str, count: int) -> str:
    """Which model of which vehicle was fitted to how many responses."""
    named = vehicle_with_file(vehicle.name, vehicle.identity)
    responses = f"{count} response{'s' * (count != 1)}"
    return f"{model} model of {named}, linearised about {about}, fitted to {responses}"


def _starts(
    system: System, fixed: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Starting values of what is free, a delay of all inputs included, and what is held."""
    free = [name for name in system.parameters.free_names if not name.startswith("bias_")]
    known = [*free, *([] if DELAY in free else [DELAY])]
    for name in fixed:
        if name not in known:
            remedy = f"the parameters are {', '.join(known)}"
            raise DeclarationError(f"there is no parameter {name!r}", where="--fix", remedy=remedy)
    start = {name: system.parameters[name].value for name in free if name not in fixed}
    if DELAY not in start and DELAY not in fixed:
        start[DELAY] = 0.0
    return start, dict(fixed)


def _refuse_other_signals(system: System, names: Names) -> None:
    for option, asked, known in (
        ("--input", names.inputs, system.input_names),
        ("--output", names.outputs, system.output_names),
    ):
        for name in asked:
            if name not in known:
                what, remedy = f"the model has no {name!r}", f"it has {', '.join(known)}"
                raise DeclarationError(what, where=option, remedy=remedy)


def model_lines(found: FittedModel) -> list[str]:
    """The costs of the fitted model, one sentence each."""
    lines = list(found.sentences)
    for name, cost in zip(found.pairs, found.fit.costs, strict=True):
        said = "close to the data" if cost <= BEST else "acceptable" if cost <= GOOD else "poor"
        lines.append(f"{name}: cost {cost:.3g}, {said}")
    return [*lines, f"mean cost {found.fit.cost:.3g}"]


def model_table(found: FittedModel, caption: str = "") -> Table:
    """The parameters of a fitted model; those that were fixed come last."""
    fit = found.fit
    names, fixed = list(fit.names), list(fit.fixed)
    none = [MISSING] * len(fixed)

    def shares(sizes: np.ndarray) -> list[Cell]:
        return [_share(size, value) for size, value in zip(sizes, fit.values, strict=True)]

    values: list[Cell] = [
        Number(float(value), shown=number_text(float(value), float(std)))
        for value, std in zip(fit.values, fit.std, strict=True)
    ]
    spread: list[Cell] = [formatted(float(std), ".2g") for std in fit.std]
    start: list[Cell] = [formatted(float(value), ".5g") for value in fit.start]
    return table(
        caption,
        (Column("parameter"), [*names, *fixed]),
        (
            Column("value", BY_ROW),
            [*values, *(formatted(float(fit.fixed[name]), ".5g") for name in fixed)],
        ),
        (Column("std", BY_ROW, beside=True), [*spread, *["fixed"] * len(fixed)]),
        (Column("Cramer-Rao", "%"), [*shares(fit.cramer_rao), *none]),
        (Column("insensitivity", "%"), [*shares(fit.insensitivity), *none]),
        (Column("start", BY_ROW), [*start, *none]),
        units=[found.units.get(name, "") for name in (*names, *fixed)],
    )


def _share(part: float, value: float) -> Cell:
    share = 100.0 * float(part) / max(abs(float(value)), 1e-300)
    return formatted(share if math.isfinite(share) and share < 1000.0 else None, ".3g")


def model_content(found: FittedModel) -> dict[str, Any]:
    """The fitted model for ``responses.json``."""
    fit = found.fit
    return {
        "model": found.model,
        "vehicle": found.vehicle,
        "cost": fit.cost,
        "costs": dict(zip(found.pairs, fit.costs, strict=True)),
        "converged": fit.converged,
        "parameters": {
            name: {
                "value": float(fit.values[k]),
                "std": float(fit.std[k]),
                "cramer_rao": float(fit.cramer_rao[k]),
                "insensitivity": float(fit.insensitivity[k]),
                "start": float(fit.start[k]),
                "unit": found.units.get(name, ""),
            }
            for k, name in enumerate(fit.names)
        },
        "fixed": dict(fit.fixed),
    }
