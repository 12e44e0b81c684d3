"""Transfer functions and linear models fitted to estimated frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    PILOTED,
    FittedResponse,
    ResponseTarget,
    TransferFit,
    fit_transfer_functions,
    form_of,
    unnoticeable,
)
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import (
    VehicleFile,
    read_vehicle,
    refuse_unknown_model,
    vehicle_with_file,
)
from scenarios.preparation.declared_model import model_of_file
from scenarios.report.document import BY_ROW, MISSING, Cell, Column, Number, Table, formatted, table
from scenarios.report.quantities import number_text
from scenarios.responses.reading import Names
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import DeclarationError, ModelError, RecordError

# ---- Transfer functions fitted to the estimated responses

NO_DELAY = 1e-9  # s, smaller delays are rounding errors
# limit of the Cramer-Rao bound, share of a value (Tischler and Remple)
LARGEST_CRAMER_RAO_SHARE = 0.2
# limit of the insensitivity, share of a value (Tischler and Remple)
LARGEST_INSENSITIVITY_SHARE = 0.1


@dataclass(frozen=True)
class FitOptions:
    """Options of transfer-function fits.

    Attributes
    ----------
    forms : ``FORM`` for every response or ``OUTPUT=FORM``; empty fits none.
    fixed : ``NAME=VALUE``.
    shared_poles : all denominators are the same.
    """

    forms: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    shared_poles: bool = False

    def __post_init__(self) -> None:
        if not self.forms and self.shared_poles:
            remedy = "add --fit FORM"
            raise DeclarationError("no form is named", where="--shared-poles", remedy=remedy)

    @property
    def values(self) -> dict[str, float]:
        """The fixed parameters."""
        out = {}
        for text in self.fixed:
            name, _, value = text.partition("=")
            try:
                out[name.strip()] = float(value)
            except ValueError:
                remedy = "write NAME=VALUE, as in delay=0"
                raise DeclarationError(
                    f"{text!r} fixes nothing", where="--fix", remedy=remedy
                ) from None
        return out


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Estimated response over fitted one along the usable band.

    Attributes
    ----------
    frequency : Hz.
    gain, phase : of this ratio, dB and deg.
    gain_error, phase_error : half widths of their 95 % bands.
    """

    frequency: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    gain_error: np.ndarray
    phase_error: np.ndarray

    @property
    def piloted(self) -> np.ndarray:
        """Whether frequencies are in the range of the envelopes of unnoticeable dynamics, bool."""
        omega = 2.0 * math.pi * self.frequency
        return np.asarray((omega >= PILOTED[0]) & (omega <= PILOTED[1]))

    @property
    def outside(self) -> np.ndarray:
        """Whether the mismatch exceeds the envelopes by more than its 95 % band, bool."""
        limits = unnoticeable(2.0 * math.pi * self.frequency)
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
    fit : all of them.
    places : row and column of the response of each.
    mismatches : of each.
    """

    fit: TransferFit
    places: tuple[tuple[int, int], ...]
    mismatches: tuple[Mismatch, ...]

    def of(self, row: int, column: int) -> tuple[FittedResponse, Mismatch] | None:
        """Return the function of a response and its mismatch; None if none was fitted."""
        if (row, column) not in self.places:
            return None
        at = self.places.index((row, column))
        return self.fit.functions[at], self.mismatches[at]


def fits_of(responses: FrequencyResponses, names: Names, options: FitOptions) -> Fits | None:
    """Fit the forms to the responses in their usable bands; None if no form is named.

    Raises DeclarationError, RecordError or ModelError in one line.
    """
    if not options.forms:
        return None
    by_output = _by_output(options.forms, names.outputs)
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
    each = tuple(
        _mismatch(responses, place, function)
        for place, function in zip(places, fit.functions, strict=True)
    )
    return Fits(fit, tuple(places), each)


def target_of(responses: FrequencyResponses, place: tuple[int, int], name: str) -> ResponseTarget:
    """Return the usable band of a response, as it is fitted."""
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


def _by_output(forms: Sequence[str], outputs: Sequence[str]) -> Mapping[str, str]:
    out: dict[str, str] = {}
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
            if name in out:
                what = f"two forms for {name}"
                raise DeclarationError(what, where="--fit", remedy="name one for each output")
            out[name] = form
    return out


def _mismatch(
    responses: FrequencyResponses, place: tuple[int, int], function: FittedResponse
) -> Mismatch:
    usable = responses.usable[place]
    frequency = responses.frequency[usable]
    response = responses.response[place][usable]
    ratio = response / function.response(2.0 * math.pi * frequency)
    share = np.minimum(
        (responses.half_width()[place] / np.abs(responses.response[place]))[usable], 0.999
    )
    phase_half_width = responses.phase_half_width()[place][usable]
    return Mismatch(
        frequency,
        20.0 * np.log10(np.abs(ratio)),
        np.degrees(np.angle(ratio)),
        -20.0 * np.log10(1.0 - share),
        np.degrees(phase_half_width),
    )


def cost_sentence(function: FittedResponse) -> str:
    """Return ``"cost 12.3: close to the data (below 50)"``."""
    cost = function.cost
    if cost <= NEARLY_PERFECT_COST:
        verdict = f"close to the data (below {NEARLY_PERFECT_COST:g})"
    elif cost <= ACCEPTABLE_COST:
        verdict = f"acceptable (below {ACCEPTABLE_COST:g})"
    else:
        verdict = f"the form does not describe the response (above {ACCEPTABLE_COST:g})"
    return f"cost {cost:.3g}: {verdict}"


def envelope_sentence(function: FittedResponse, mismatch: Mismatch) -> str:
    """Whether a pilot would notice the mismatch of a low-order form; empty for plain orders."""
    if function.form.name not in FORMS or not mismatch.piloted.any():
        return ""
    outside = mismatch.outside
    rad = 2.0 * math.pi * mismatch.frequency
    judged = rad[mismatch.piloted]
    band = f"{judged[0]:.3g} to {judged[-1]:.3g} rad/s"
    if not outside.any():
        return f"mismatch within the envelopes of unnoticeable added dynamics, {band}"
    beyond = rad[outside]
    return (
        f"mismatch beyond the envelopes of unnoticeable added dynamics at {outside.sum()} of "
        f"{judged.size} frequencies from {band}, first at {beyond[0]:.3g} rad/s"
    )


def transfer_text(function: FittedResponse) -> str:
    """``"(5.98 s + 7.3) / (s^2 + 3.2 s + 16.1) exp(-0.0101 s)"``."""
    top, bottom = _polynomial(function.numerator), _polynomial(function.denominator)
    delay = function.values["delay"]
    return f"({top}) / ({bottom})" + (f" exp(-{delay:.4g} s)" if delay > NO_DELAY else "")


def _polynomial(coefficients: np.ndarray) -> str:
    order = len(coefficients) - 1
    parts: list[str] = []
    for n, value in enumerate(coefficients.tolist()):
        power = order - n
        letter = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        number = f"{abs(value):.4g}"
        body = letter if letter and number == "1" else f"{number} {letter}".strip()
        sign = "-" if value < 0 else "+"
        parts.append((f"{sign} " if parts else ("-" if value < 0 else "")) + body)
    return " ".join(parts)


def fit_cautions(fits: Fits | None) -> tuple[str, ...]:
    """Return the cautions on the fits, one sentence each."""
    if fits is None:
        return ()
    out = [] if fits.fit.converged else ["the search for the transfer functions did not end"]
    for function, mismatch in zip(fits.fit.functions, fits.mismatches, strict=True):
        if function.cost > ACCEPTABLE_COST:
            out.append(f"{function.name}, {function.form.name}: {cost_sentence(function)}")
        out += _outside_band(function, mismatch)
        uncertain = [name for name in function.std if _hardly_determined(function, name)]
        if _may_be_none(function):
            delay, std = function.values["delay"], function.std["delay"]
            shown = delay if delay > NO_DELAY else 0.0
            out.append(
                f"{function.name}: the delay is {shown:.2g} +- {std:.2g} s, which may be none; "
                "--fix delay=0 leaves it out"
            )
            uncertain = [name for name in uncertain if name != "delay"]
        if uncertain:
            limits = (
                f"deviation above {100 * LARGEST_CRAMER_RAO_SHARE:.0f} % or "
                f"{100 * LARGEST_INSENSITIVITY_SHARE:.0f} % alone"
            )
            sentence = f"{function.name}: {', '.join(uncertain)} hardly determined ({limits})"
            out.append(f"{sentence}; fix one of them with --fix, or take a lower order")
    return tuple(out)


def _outside_band(function: FittedResponse, mismatch: Mismatch) -> list[str]:
    """Return a caution if a fitted mode lies outside the band that was used: a dip of the coherence
    at a lightly damped mode ends the usable band there.
    """
    low, high = (2.0 * math.pi * float(mismatch.frequency[end]) for end in (0, -1))
    mode = function.values.get("frequency")
    if mode is None or low <= mode <= high:
        return []
    return [
        f"{function.name}: the fitted mode at {mode:.3g} rad/s lies outside the usable band, "
        f"{low:.3g} to {high:.3g} rad/s; a lower --coherence or longer windows (--window) may "
        "take it in"
    ]


def _hardly_determined(function: FittedResponse, name: str) -> bool:
    """Return whether one of the two deviations of a free parameter exceeds its limit."""
    size = abs(function.values[name])
    return (
        function.std[name] > LARGEST_CRAMER_RAO_SHARE * size
        or function.insensitivity[name] > LARGEST_INSENSITIVITY_SHARE * size
    )


def _may_be_none(function: FittedResponse) -> bool:
    """Return whether a free delay differs from zero by less than two standard deviations."""
    return "delay" in function.std and function.values["delay"] < 2.0 * function.std["delay"]


DELAY = "delay"


@dataclass(frozen=True)
class ModelOptions:
    """Options of a model fit: name or file of the ``model`` (None: no fit), constants and starting
    values in ``vehicle``, and ``fixed`` parameters.
    """

    model: str | None = None
    vehicle: Path | None = None
    fixed: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class FittedResponseModel:
    """A linear model fitted to the responses at ``places`` ``(row, column)``.

    ``model``, ``vehicle``: names. ``pairs``: ``OUTPUT/INPUT`` of each response. ``omegas``: rad/s,
    of each response. ``units``: by parameter. ``sentences``: notes. ``file``: vehicle file.
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
        """Frequencies, rad/s, and response of the fitted model; None if it was not fitted."""
        if (row, column) not in self.places:
            return None
        at = self.places.index((row, column))
        return self.omegas[at], self.fit.responses[at]

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions on the fit, one sentence each."""
        fit, out = self.fit, []
        if not fit.converged:
            out.append(f"the search for the parameters of {self.model} did not end")
        for name, cost in zip(self.pairs, fit.costs, strict=True):
            if cost > ACCEPTABLE_COST:
                sentence = f"above {ACCEPTABLE_COST:g}: it does not fit"
                out.append(f"{name}: cost {cost:.3g} of {self.model}, {sentence}")
        size = np.maximum(np.abs(fit.values), 1e-300)
        weak = (fit.cramer_rao > LARGEST_CRAMER_RAO_SHARE * size) | (
            fit.insensitivity > LARGEST_INSENSITIVITY_SHARE * size
        )
        uncertain = [name for name, each in zip(fit.names, weak.tolist(), strict=True) if each]
        if uncertain:
            limits = (
                f"{100 * LARGEST_CRAMER_RAO_SHARE:.0f} % and insensitivity "
                f"{100 * LARGEST_INSENSITIVITY_SHARE:.0f} %"
            )
            out.append(
                f"{', '.join(uncertain)} hardly determined (Cramer-Rao bound {limits}); hold "
                "one of them with --fix"
            )
        return tuple(out)


def model_fit_of(
    estimated_responses: FrequencyResponses,
    names: Names,
    options: ModelOptions,
    hold_step: float | None = None,
) -> FittedResponseModel | None:
    """Fit the model to all responses that have a usable band; None if no model is
    named.

    The model is linearised about rest, or about level flight at the starting values. A delay of all
    inputs is free unless fixed. ``hold_step``: s, time for which the inputs are held. The
    estimated responses were divided by the lag of the hold, which an output with direct feedthrough
    does not have; so the model is discretised with held inputs and divided by the same lag.

    Raises
    ------
    DeclarationError, RecordError : signals that the model lacks, or no usable band.
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
        for column, input_name in enumerate(names.inputs):
            if np.count_nonzero(estimated_responses.usable[row, column]) >= 3:
                name = f"{output}/{input_name}"
                places.append((row, column))
                pairs.append(name)
                targets.append(target_of(estimated_responses, (row, column), name))
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
        delay_value = values.get(DELAY, 0.0)
        eye, out = np.eye(len(space.A)), []
        A, B = space.A, space.B
        if hold_step is not None:
            n, r = B.shape
            block = np.zeros((n + r, n + r))
            block[:n, :n], block[:n, n:] = A, B
            transition = expm(hold_step * block)
            A, B = transition[:n, :n], transition[:n, n:]
        for target, k, m in zip(targets, outputs, inputs, strict=True):
            s = 1j * target.omega
            z = s if hold_step is None else np.exp(s * hold_step)
            inside = np.linalg.solve(z[:, None, None] * eye - A, B[None, :, m, None])
            row = (space.C[k] @ inside)[:, 0] + space.D[k, m]
            hold_response = (
                1.0 if hold_step is None else (1.0 - np.exp(-s * hold_step)) / (s * hold_step)
            )
            out.append(row * np.exp(-s * delay_value) / hold_response)
        return out

    start, fixed = _starting_values(system, options.fixed or {})
    try:
        fit = fit_model(targets, responses, start, fixed, {DELAY: 0.0})
    except ModelError as error:
        raise DeclarationError(error.what, where="--model", remedy=error.remedy) from None
    units = {name: system.parameters[name].unit for name in (*start, *fixed) if name != DELAY}
    units |= {DELAY: "s"}
    about = "level flight" if trim is not None else "rest"
    return FittedResponseModel(
        options.model,
        vehicle.name,
        fit,
        tuple(places),
        tuple(pairs),
        units,
        tuple(target.omega for target in targets),
        (_fit_sentence(options.model, vehicle, about, len(pairs)),),
        vehicle.identity,
    )


def _fit_sentence(model: str, vehicle: VehicleFile, about: str, count: int) -> str:
    """Sentence on the model, the vehicle and the number of responses that were fitted."""
    named = vehicle_with_file(vehicle.name, vehicle.identity)
    responses = f"{count} response{'s' * (count != 1)}"
    return f"{model} model of {named}, linearised about {about}, fitted to {responses}"


def _starting_values(
    system: System, fixed: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Starting values of the free parameters, with a delay of all inputs, and the fixed ones."""
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
    for option, requested, known in (
        ("--input", names.inputs, system.input_names),
        ("--output", names.outputs, system.output_names),
    ):
        for name in requested:
            if name not in known:
                what, remedy = f"the model has no {name!r}", f"it has {', '.join(known)}"
                raise DeclarationError(what, where=option, remedy=remedy)


def model_lines(fitted: FittedResponseModel) -> list[str]:
    """Return the costs of the fitted model, one sentence each."""
    lines = list(fitted.sentences)
    for name, cost in zip(fitted.pairs, fitted.fit.costs, strict=True):
        verdict = (
            "close to the data"
            if cost <= NEARLY_PERFECT_COST
            else "acceptable"
            if cost <= ACCEPTABLE_COST
            else "poor"
        )
        lines.append(f"{name}: cost {cost:.3g}, {verdict}")
    return [*lines, f"mean cost {fitted.fit.cost:.3g}"]


def model_table(fitted: FittedResponseModel, caption: str = "") -> Table:
    """Return the parameters of a fitted model; those that were fixed come last."""
    fit = fitted.fit
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
        units=[fitted.units.get(name, "") for name in (*names, *fixed)],
    )


def _share(part: float, value: float) -> Cell:
    share = 100.0 * float(part) / max(abs(float(value)), 1e-300)
    return formatted(share if math.isfinite(share) and share < 1000.0 else None, ".3g")


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
