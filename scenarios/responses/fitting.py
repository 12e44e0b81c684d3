"""Transfer functions and linear models fitted to estimated frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from ident.flying_qualities.modes import level_flight, state_space
from ident.frequency_response import FrequencyResponses
from ident.frequency_response.model_fit import ModelFit, fit_model
from ident.frequency_response.transfer_function import (
    ACCEPTABLE_COST,
    FORMS,
    NEARLY_PERFECT_COST,
    PILOT_BAND,
    FittedResponse,
    ResponseTarget,
    TransferFit,
    fit_transfer_functions,
    form_of,
    unnoticeable_envelopes,
)
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import read_vehicle, refuse_unknown_model, vehicle_with_file
from scenarios.preparation.declared_model import model_of_file
from scenarios.report.document import BY_ROW, MISSING, Cell, Column, Number, Table, formatted, table
from scenarios.report.quantities import number_text
from scenarios.responses.reading import Names
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import DeclarationError, ModelError, RecordError

# ---- Transfer functions fitted to the estimated responses

NO_DELAY = 1e-9  # s, smaller delays are rounding errors
# Limits for a well determined parameter, over its value (Tischler and Remple).
LARGEST_CRAMER_RAO_SHARE = 0.2
LARGEST_INSENSITIVITY_SHARE = 0.1
FEWEST_FREQUENCIES = 3  # usable frequencies of a response to which a model is fitted
LARGEST_SHOWN_PERCENT = 1000.0  # a larger share of a value is shown as a dash
SMALLEST_SIZE = 1e-300  # keeps a quotient finite


@dataclass(frozen=True)
class FitOptions:
    """Options of transfer-function fits.

    Attributes
    ----------
    forms : ``FORM`` for every response or ``OUTPUT=FORM``; empty fits none.
    fixed : fixed parameters, ``NAME=VALUE``.
    shared_poles : whether all responses have the same denominator.
    """

    forms: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    shared_poles: bool = False

    def __post_init__(self) -> None:
        if not self.forms and self.shared_poles:
            what, remedy = "no form is named", "add --fit FORM"
            raise DeclarationError(what, where="--shared-poles", remedy=remedy)

    @property
    def values(self) -> dict[str, float]:
        """Values of the fixed parameters."""
        values = {}
        for text in self.fixed:
            name, _, value = text.partition("=")
            try:
                values[name.strip()] = float(value)
            except ValueError:
                remedy = "write NAME=VALUE, as in delay=0"
                raise DeclarationError(
                    f"{text!r} fixes nothing", where="--fix", remedy=remedy
                ) from None
        return values


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Ratio of the estimated to the fitted response in the usable band; arrays ``(F,)``.

    Attributes
    ----------
    frequency : frequencies, Hz.
    gain, phase : gain and phase of the ratio, dB and deg.
    gain_error, phase_error : half widths of their 95 % bands, dB and deg.
    """

    frequency: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    gain_error: np.ndarray
    phase_error: np.ndarray

    @property
    def piloted(self) -> np.ndarray:
        """Whether each frequency is in the range of the envelopes of unnoticeable dynamics."""
        omega = 2.0 * math.pi * self.frequency
        return np.asarray((omega >= PILOT_BAND[0]) & (omega <= PILOT_BAND[1]))

    @property
    def outside(self) -> np.ndarray:
        """Whether the mismatch at each frequency exceeds the envelopes by more than its error."""
        limits = unnoticeable_envelopes(2.0 * math.pi * self.frequency)
        gain = (self.gain - self.gain_error > limits.high_gain) | (
            self.gain + self.gain_error < limits.low_gain
        )
        phase = (self.phase - self.phase_error > limits.high_phase) | (
            self.phase + self.phase_error < limits.low_phase
        )
        return np.asarray((gain | phase) & self.piloted)


@dataclass(frozen=True, eq=False)
class Fits:
    """Transfer functions of some responses.

    Attributes
    ----------
    fit : the fitted functions.
    places : row and column of the response of each function.
    mismatches : mismatch of each function.
    """

    fit: TransferFit
    places: tuple[tuple[int, int], ...]
    mismatches: tuple[Mismatch, ...]

    def of(self, row: int, column: int) -> tuple[FittedResponse, Mismatch] | None:
        """Return the function of a response and its mismatch; None if none was fitted."""
        if (row, column) not in self.places:
            return None
        number = self.places.index((row, column))
        return self.fit.functions[number], self.mismatches[number]


def fits_of(responses: FrequencyResponses, names: Names, options: FitOptions) -> Fits | None:
    """Fit the forms to the responses in their usable bands; return None if no form is named."""
    if not options.forms:
        return None
    by_output = _forms_by_output(options.forms, names.outputs)
    places, targets, forms = [], [], []
    for row, output in enumerate(names.outputs):
        for column, input_name in enumerate(names.inputs):
            if output not in by_output:
                continue
            usable = responses.usable[row, column]
            if not usable.any():
                what = f"no usable band of {output}/{input_name} to fit"
                raise RecordError(what, where="--fit", remedy="lower --coherence, or leave it out")
            targets.append(target_of(responses, (row, column), f"{output}/{input_name}"))
            places.append((row, column))
            forms.append(form_of(by_output[output]))
    try:
        fit = fit_transfer_functions(
            targets, forms, options.values, shared_poles=options.shared_poles
        )
    except ModelError as error:
        option = {"fix": "--fix", "shared poles": "--shared-poles"}.get(error.where, "--fit")
        raise DeclarationError(error.what, where=option, remedy=error.remedy) from None
    mismatches = tuple(
        _mismatch(responses, place, function)
        for place, function in zip(places, fit.functions, strict=True)
    )
    return Fits(fit, tuple(places), mismatches)


def target_of(responses: FrequencyResponses, place: tuple[int, int], name: str) -> ResponseTarget:
    """Return the usable band of a response as the target of a fit."""
    usable = responses.usable[place]
    coherence = (
        responses.coherence[place[0]] if responses.joint else responses.partial_coherence[place]
    )
    return ResponseTarget(
        name,
        2.0 * math.pi * responses.frequency[usable],
        responses.response[place][usable],
        coherence[usable],
        responses.std[place][usable],
        responses.lengths[place[0]][usable],
    )


def _forms_by_output(forms: Sequence[str], outputs: Sequence[str]) -> Mapping[str, str]:
    """Return the form of each output. Raises DeclarationError for unknown or double ones."""
    by_output: dict[str, str] = {}
    for text in forms:
        output, equals, form = text.rpartition("=")
        if equals and output not in outputs:
            remedy = f"the outputs are {', '.join(outputs)}"
            raise DeclarationError(f"there is no output {output!r}", where="--fit", remedy=remedy)
        try:
            form_of(form)
        except ModelError as error:
            raise DeclarationError(error.what, where="--fit", remedy=error.remedy) from None
        for name in (output,) if equals else outputs:
            if name in by_output:
                what = f"two forms for {name}"
                raise DeclarationError(what, where="--fit", remedy="name one for each output")
            by_output[name] = form
    return by_output


def _mismatch(
    responses: FrequencyResponses, place: tuple[int, int], function: FittedResponse
) -> Mismatch:
    """Return the mismatch of a fitted function in the usable band of its response."""
    usable = responses.usable[place]
    frequency = responses.frequency[usable]
    response = responses.response[place][usable]
    ratio = response / function.response(2.0 * math.pi * frequency)
    share = np.minimum(responses.half_width()[place][usable] / np.abs(response), 0.999)
    phase_half_width = responses.phase_half_width()[place][usable]
    return Mismatch(
        frequency,
        20.0 * np.log10(np.abs(ratio)),
        np.degrees(np.angle(ratio)),
        -20.0 * np.log10(1.0 - share),
        np.degrees(phase_half_width),
    )


def cost_sentence(function: FittedResponse) -> str:
    """Return the cost of a fit in words, such as ``"cost 12.3: close to the data (below 50)"``."""
    cost = function.cost
    if cost <= NEARLY_PERFECT_COST:
        verdict = f"close to the data (below {NEARLY_PERFECT_COST:g})"
    elif cost <= ACCEPTABLE_COST:
        verdict = f"acceptable (below {ACCEPTABLE_COST:g})"
    else:
        verdict = f"the form does not describe the response (above {ACCEPTABLE_COST:g})"
    return f"cost {cost:.3g}: {verdict}"


def envelope_sentence(function: FittedResponse, mismatch: Mismatch) -> str:
    """Return whether a pilot would notice the mismatch; empty for a form of orders, such as 1/2."""
    if function.form.name not in FORMS or not mismatch.piloted.any():
        return ""
    outside = mismatch.outside
    compared = mismatch.frequency[mismatch.piloted]
    band = f"{compared[0]:.3g} to {compared[-1]:.3g} Hz"
    if not outside.any():
        return f"mismatch within the envelopes of unnoticeable added dynamics, {band}"
    beyond = mismatch.frequency[outside]
    return (
        f"mismatch beyond the envelopes of unnoticeable added dynamics at {outside.sum()} of "
        f"{compared.size} frequencies from {band}, first at {beyond[0]:.3g} Hz"
    )


def transfer_text(function: FittedResponse) -> str:
    """Return text such as ``"(5.98 s + 7.3) / (s^2 + 3.2 s + 16.1) exp(-0.0101 s)"``."""
    numerator, denominator = _polynomial(function.numerator), _polynomial(function.denominator)
    delay = function.values["delay"]
    lag = f" exp(-{delay:.4g} s)" if delay > NO_DELAY else ""
    return f"({numerator}) / ({denominator}){lag}"


def _polynomial(coefficients: np.ndarray) -> str:
    """Return a polynomial of s as text; the highest power is first."""
    order = len(coefficients) - 1
    text = ""
    for i, value in enumerate(coefficients.tolist()):
        power = {order: "", order - 1: "s"}.get(i, f"s^{order - i}")
        number = f"{abs(value):.4g}"
        term = power if power and number == "1" else f"{number} {power}".strip()
        if text:
            text += f" {'-' if value < 0 else '+'} {term}"
        else:
            text = f"-{term}" if value < 0 else term
    return text


def fit_cautions(fits: Fits | None) -> tuple[str, ...]:
    """Return the cautions on the fits, one sentence each."""
    if fits is None:
        return ()
    cautions = [] if fits.fit.converged else ["the search for the transfer functions did not end"]
    for function, mismatch in zip(fits.fit.functions, fits.mismatches, strict=True):
        if function.cost > ACCEPTABLE_COST:
            cautions.append(f"{function.name}, {function.form.name}: {cost_sentence(function)}")
        cautions += _outside_band(function, mismatch)
        sizes = {name: abs(function.values[name]) for name in function.std}
        uncertain = [
            name
            for name, size in sizes.items()
            if function.std[name] > LARGEST_CRAMER_RAO_SHARE * size
            or function.insensitivity[name] > LARGEST_INSENSITIVITY_SHARE * size
        ]
        delay, delay_std = function.values["delay"], function.std.get("delay")
        if delay_std is not None and delay < 2.0 * delay_std:
            shown = delay if delay > NO_DELAY else 0.0
            cautions.append(
                f"{function.name}: the delay is {shown:.2g} +- {delay_std:.2g} s, which may be "
                "none; --fix delay=0 leaves it out"
            )
            uncertain = [name for name in uncertain if name != "delay"]
        if uncertain:
            limits = (
                f"deviation above {100 * LARGEST_CRAMER_RAO_SHARE:.0f} % or "
                f"{100 * LARGEST_INSENSITIVITY_SHARE:.0f} % alone"
            )
            sentence = f"{function.name}: {', '.join(uncertain)} hardly determined ({limits})"
            cautions.append(f"{sentence}; fix one of them with --fix, or take a lower order")
    return tuple(cautions)


def _outside_band(function: FittedResponse, mismatch: Mismatch) -> list[str]:
    """Return a caution if a fitted mode is outside the usable band."""
    # The coherence may have a dip near a lightly damped mode, at which the band then ends.
    low, high = (float(mismatch.frequency[end]) for end in (0, -1))
    mode = function.values.get("frequency")
    if mode is None or low <= mode / math.tau <= high:
        return []
    return [
        f"{function.name}: the fitted mode at {mode / math.tau:.3g} Hz lies outside the usable "
        f"band, {low:.3g} to {high:.3g} Hz; a lower --coherence or longer windows (--window) may "
        "take it in"
    ]


# ---- Linear models fitted to the estimated responses

DELAY = "delay"


@dataclass(frozen=True)
class ModelOptions:
    """Options of a model fit.

    Attributes
    ----------
    model : name or file of the model; None fits no model.
    vehicle : file of constants and starting values.
    fixed : values of fixed parameters.
    """

    model: str | None = None
    vehicle: Path | None = None
    fixed: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class FittedResponseModel:
    """A linear model fitted to several responses.

    Attributes
    ----------
    model, vehicle : names of model and vehicle.
    fit : the fit.
    places, pairs : row and column, and name ``OUTPUT/INPUT``, of each response.
    units : unit of each parameter.
    omegas : frequencies of each response, rad/s.
    sentences, file : notes, and the vehicle file or None.
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
        """Return frequencies (rad/s) and response of the model; None if it was not fitted there."""
        if (row, column) not in self.places:
            return None
        number = self.places.index((row, column))
        return self.omegas[number], self.fit.responses[number]

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions on the fit, one sentence each."""
        fit, cautions = self.fit, []
        if not fit.converged:
            cautions.append(f"the search for the parameters of {self.model} did not end")
        for name, cost in zip(self.pairs, fit.costs, strict=True):
            if cost > ACCEPTABLE_COST:
                sentence = f"above {ACCEPTABLE_COST:g}: it does not fit"
                cautions.append(f"{name}: cost {cost:.3g} of {self.model}, {sentence}")
        size = np.maximum(np.abs(fit.values), SMALLEST_SIZE)
        uncertain = (fit.cramer_rao > LARGEST_CRAMER_RAO_SHARE * size) | (
            fit.insensitivity > LARGEST_INSENSITIVITY_SHARE * size
        )
        if np.any(uncertain):
            names = [name for name, flag in zip(fit.names, uncertain, strict=True) if flag]
            limits = (
                f"{100 * LARGEST_CRAMER_RAO_SHARE:.0f} % and insensitivity "
                f"{100 * LARGEST_INSENSITIVITY_SHARE:.0f} %"
            )
            cautions.append(
                f"{', '.join(names)} hardly determined (Cramer-Rao bound {limits}); hold "
                "one of them with --fix"
            )
        return tuple(cautions)


def model_fit_of(
    estimated_responses: FrequencyResponses,
    names: Names,
    options: ModelOptions,
    hold_step: float | None = None,
) -> FittedResponseModel | None:
    """Fit the model to all responses that have a usable band; return None if no model is named.

    The model is linearised about rest, or about level flight at the starting values. A delay of all
    inputs is free unless fixed. ``hold_step`` is the time for which the inputs are held, s. The
    estimated responses were divided by the response of the hold, which outputs with direct
    feedthrough do not have. The model is therefore discretised and divided in the same way.

    Raises
    ------
    DeclarationError, RecordError : the model lacks a signal, or no response has a usable band.
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
    for place in product(range(len(names.outputs)), range(len(names.inputs))):
        if np.count_nonzero(estimated_responses.usable[place]) >= FEWEST_FREQUENCIES:
            name = f"{names.outputs[place[0]]}/{names.inputs[place[1]]}"
            places.append(place)
            pairs.append(name)
            targets.append(target_of(estimated_responses, place, name))
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
        A, B = space.A, space.B
        model_responses = []
        if hold_step is not None:
            A, B = _discretised(A, B, hold_step)
        for target, output, column in zip(targets, outputs, inputs, strict=True):
            s = 1j * target.omega
            z, hold_response = s, np.ones_like(s)
            if hold_step is not None:
                z = np.exp(s * hold_step)
                hold_response = (1.0 - np.exp(-s * hold_step)) / (s * hold_step)
            matrices = z[:, None, None] * np.eye(len(A)) - A
            states = np.linalg.solve(matrices, B[None, :, column, None])
            response = (space.C[output] @ states)[:, 0] + space.D[output, column]
            delay = np.exp(-s * values.get(DELAY, 0.0))
            model_responses.append(response * delay / hold_response)
        return model_responses

    start, fixed = _starting_values(system, options.fixed or {})
    try:
        fit = fit_model(targets, responses, start, fixed, {DELAY: 0.0})
    except ModelError as error:
        raise DeclarationError(error.what, where="--model", remedy=error.remedy) from None
    units = {name: system.parameters[name].unit for name in (*start, *fixed) if name != DELAY}
    units |= {DELAY: "s"}
    sentence = (
        f"{options.model} model of {vehicle_with_file(vehicle.name, vehicle.identity)}, linearised "
        f"about {'level flight' if trim is not None else 'rest'}, fitted to {len(pairs)} "
        f"response{'s' * (len(pairs) != 1)}"
    )
    return FittedResponseModel(
        options.model,
        vehicle.name,
        fit,
        tuple(places),
        tuple(pairs),
        units,
        tuple(target.omega for target in targets),
        (sentence,),
        vehicle.identity,
    )


def _discretised(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    n, r = B.shape
    block = np.zeros((n + r, n + r))
    block[:n, :n], block[:n, n:] = A, B
    transition = expm(step * block)
    return transition[:n, :n], transition[:n, n:]


def _starting_values(
    system: System, fixed: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return starting values of free parameters, including a delay, and values of fixed ones."""
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
    """Raise DeclarationError for a signal that the model does not have."""
    for option, requested, known in (
        ("--input", names.inputs, system.input_names),
        ("--output", names.outputs, system.output_names),
    ):
        for name in requested:
            if name not in known:
                what, remedy = f"the model has no {name!r}", f"it has {', '.join(known)}"
                raise DeclarationError(what, where=option, remedy=remedy)


def model_lines(fitted: FittedResponseModel) -> list[str]:
    """Return notes on the fitted model and its costs, one sentence each."""
    lines = list(fitted.sentences)
    for name, cost in zip(fitted.pairs, fitted.fit.costs, strict=True):
        verdict = "acceptable" if cost <= ACCEPTABLE_COST else "poor"
        if cost <= NEARLY_PERFECT_COST:
            verdict = "close to the data"
        lines.append(f"{name}: cost {cost:.3g}, {verdict}")
    return [*lines, f"mean cost {fitted.fit.cost:.3g}"]


def model_table(fitted: FittedResponseModel, caption: str = "") -> Table:
    """Return a table of the parameters of a fitted model; fixed parameters are last."""
    fit = fitted.fit
    names, dashes = [*fit.names, *fit.fixed], [MISSING] * len(fit.fixed)

    def shares(sizes: np.ndarray) -> list[Cell]:
        return [percent_cell(size, value) for size, value in zip(sizes, fit.values, strict=True)]

    values: list[Cell] = [
        Number(float(value), shown=number_text(float(value), float(std)))
        for value, std in zip(fit.values, fit.std, strict=True)
    ]
    stds: list[Cell] = [formatted(float(std), ".2g") for std in fit.std]
    start: list[Cell] = [formatted(float(value), ".5g") for value in fit.start]
    fixed: list[Cell] = [formatted(float(value), ".5g") for value in fit.fixed.values()]
    return table(
        caption,
        (Column("parameter"), names),
        (Column("value", BY_ROW), [*values, *fixed]),
        (Column("std", BY_ROW, beside=True), [*stds, *["fixed"] * len(fixed)]),
        (Column("Cramer-Rao", "%"), [*shares(fit.cramer_rao), *dashes]),
        (Column("insensitivity", "%"), [*shares(fit.insensitivity), *dashes]),
        (Column("start", BY_ROW), [*start, *dashes]),
        units=[fitted.units.get(name, "") for name in names],
    )


def percent_cell(part: float, value: float) -> Cell:
    """Return ``part`` in per cent of a value; a dash if it is too large."""
    percent = 100.0 * float(part) / max(abs(float(value)), SMALLEST_SIZE)
    shown = math.isfinite(percent) and percent < LARGEST_SHOWN_PERCENT
    return formatted(percent if shown else None, ".3g")


def model_content(fitted: FittedResponseModel) -> dict[str, Any]:
    """Return the fitted model for ``responses.json``."""
    fit = fitted.fit
    return {
        "model": fitted.model,
        "vehicle": fitted.vehicle,
        "cost": fit.cost,
        "costs": dict(zip(fitted.pairs, fit.costs, strict=True)),
        "converged": fit.converged,
        "parameters": {
            name: {
                "value": float(fit.values[k]),
                "std": float(fit.std[k]),
                "cramer_rao": float(fit.cramer_rao[k]),
                "insensitivity": float(fit.insensitivity[k]),
                "start": float(fit.start[k]),
                "unit": fitted.units.get(name, ""),
            }
            for k, name in enumerate(fit.names)
        },
        "fixed": dict(fit.fixed),
    }
