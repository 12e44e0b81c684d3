"""Preparation of a diagnosis: settings of the search, records, candidate effects, parameters at
bounds, and the reading of inputs between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ident.tracing.diagnosis import (
    EFFORTS,
    NORMAL,
    TIMES,
    Data,
    Diagnosis,
    Quantity,
    TraceSettings,
    Verdict,
)
from scenarios.files.declarations import (
    CHANNEL_UNITS,
    WANTED,
    refuse_unknown_attributes,
    run_python,
)
from scenarios.files.measured.columns import RecordFile, identities, path_of, read_with_validation
from scenarios.files.sources import InputFile, Source, read_source
from scenarios.files.user_models import (
    Constraints,
    channel_units,
    inputs_at_rest,
    is_model_file,
    is_own,
    side_at,
)
from scenarios.files.vehicles import VEHICLE_FILE_NAME, VehicleFile, read_vehicle, vehicle_next_to
from scenarios.preparation.declared_model import DECISIVE_LOG_LIKELIHOOD_RATIO, outputs_with_bias
from scenarios.preparation.filtering import PartedRecord
from scenarios.preparation.plan import BY_HAND, Plan, Request, column_choices, declared_phase
from scenarios.preparation.plausibility import split_off
from scenarios.preparation.recording import RecordCheck
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, GroupEffect, ParameterEffect, Signal
from sim.declaration.model import Containing, Model, Noise
from sim.declaration.proposal import Traceable, Traits
from sim.errors import DeclarationError, ModelError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from ident.flying_qualities.levels import FlightPhase
    from scenarios.files.declarations import ColumnChoice

AnyEffect = TypeVar("AnyEffect", bound=Effect)

_ATTRIBUTES = tuple(
    ["name", "station", "parameters", "absent", "regularity", "aliases", "explanation", "probes"]
)
# Attributes of an effect of the older form, which has no ``traits``.
_OLDER_ATTRIBUTES = ("onset", "per_record", "plausible")


def candidates_for(model: Model, own: Sequence[Traceable] = ()) -> tuple[Traceable, ...]:
    """Return the library effects that can act on a model and are not part of it, followed by the
    user's ``own``.
    """
    from sim.effects.library import effects_for

    equations = model.equations
    in_model = {effect.name for effect in model.effects}
    if isinstance(equations, Containing):
        in_model.update(equations.contains)
    inputs = {signal.name for signal in equations.inputs}
    from_library = (
        effect
        for effect in can_act(effects_for(equations), model)
        if isinstance(effect, Traceable)
        and effect.name not in in_model
        and effect.traits.recorded_as not in inputs
        and _varies_free_parameters(effect, model)
    )
    return (*from_library, *own)


def _varies_free_parameters(effect: Effect, model: Model) -> bool:
    """Return whether all parameters that an effect varies are estimated."""
    varied: Sequence[str] = ()
    if isinstance(effect, ParameterEffect):
        varied = (effect.parameter,)
    elif isinstance(effect, GroupEffect):
        varied = effect.group
    return all(model.parameters[name].free for name in varied)


def can_act(effects: Sequence[AnyEffect], model: Model) -> tuple[AnyEffect, ...]:
    """Return the effects whose signals exist in a model; a user's own model may lack some."""
    return tuple(effect for effect in effects if not is_own(model) or _has_signals(effect, model))


def _has_signals(effect: Effect, model: Model) -> bool:
    """Return whether a model with the effect can be evaluated: it has the effect's signals."""
    try:
        system = compile_model(model.with_effects(effect))
        x, u = system.initial.values().tolist(), inputs_at_rest(model)
        p = system.parameters.values().tolist()
        with np.errstate(all="ignore"):
            system.f(0.0, x, u, p)
            system.h(0.0, x, u, p)
            system.noise(p)
    except (AttributeError, KeyError, ModelError):
        return False
    except ArithmeticError:
        pass  # All signals exist; only their values at rest cannot be computed with.
    return True


def read_effects(source: str | Path | Source, model: Model) -> tuple[Traceable, ...]:
    """Return the effects of a user's Python file that can act on a model.

    The effects are the file's ``EFFECTS`` or, without these, its ``VARIANTS``. The file is run
    once, as a Python program; the user must have named it.

    Raises
    ------
    DeclarationError : the file does not exist, fails (with its line) or has no effects; an effect
        lacks an attribute, has an unknown one or the name of a library effect; no effect can act
        on the model.
    """
    source = source if isinstance(source, Source) else read_source(source, DeclarationError, WANTED)
    where = str(source.path)
    module = run_python(source, "effects")
    effects = getattr(module, "EFFECTS", getattr(module, "VARIANTS", None))
    if not isinstance(effects, tuple | list) or not effects:
        raise DeclarationError(
            "it offers no effect",
            where=where,
            remedy="define EFFECTS, a tuple of effects, at its top level",
        )
    return checked_effects(effects, model, where, source.content)


def checked_effects(
    effects: Sequence[Any], model: Model, where: str, content: bytes | None = None
) -> tuple[Traceable, ...]:
    """Return a user's effects that can act on a model; raise DeclarationError as ``read_effects``.

    ``where`` names the file or argument of the effects in messages, ``content`` is the file's text.
    """
    from sim.effects.library import applies, library

    library_names = {effect.name for effect in library()}
    for effect in effects:
        _check(effect, where)
        refuse_unknown_attributes(effect, content, where)
        if effect.name in library_names:
            raise DeclarationError(
                f"effect {effect.name}: the library has one of this name",
                where=where,
                remedy="give yours another name",
            )
    equations = model.equations
    applicable = tuple(effect for effect in effects if applies(effect, equations))
    if not applicable:
        named = ", ".join(dict.fromkeys(effect.name for effect in effects))
        remedy = (
            f"its inputs are {_listed(equations.inputs)}, "
            f"its outputs {_listed(equations.outputs)}, its ports {_listed(equations.ports)}"
        )
        raise DeclarationError(
            f"no effect of it ({named}) can act on the {equations.name} model",
            where=where,
            remedy=remedy,
        )
    names = [effect.name for effect in applicable]
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(
                f"effect {name} is there twice", where=where, remedy="give each a name of its own"
            )
    return applicable


def _check(effect: Any, where: str) -> None:
    """Raise an error for a value that is no effect; add traits to an effect of the older form."""

    def error(what: str, remedy: str) -> DeclarationError:
        return DeclarationError(what, where=where, remedy=remedy)

    kind = type(effect).__name__
    if isinstance(effect, type):
        name = effect.__name__
        raise error(f"{name} is a class", f"put an instance into EFFECTS: {name}(...)")
    required = _ATTRIBUTES if hasattr(effect, "traits") else (*_ATTRIBUTES, *_OLDER_ATTRIBUTES)
    missing = [attribute for attribute in required if not hasattr(effect, attribute)]
    if missing == [*required]:
        raise error(
            f"{effect!r:.60} is a {kind}, not an effect",
            "leave effects of the library out, diagnose tries them all; of your own give objects "
            "or the path of their file, as docs/how-to/own-effect.md shows",
        )
    if missing == [*_OLDER_ATTRIBUTES]:
        missing = ["traits"]
    if missing:
        name = getattr(effect, "name", "")
        shown = name if isinstance(name, str) and name else kind
        remedy = "add it as docs/how-to/own-effect.md shows"
        raise error(f"effect {shown} lacks {', '.join(missing)}", remedy)
    if not hasattr(effect, "traits"):
        # Traits are a property of the class, so that copies of the effect have them, too.
        type(effect).traits = property(_traits_of_older_form)
    elif not isinstance(effect.traits, Traits):
        what = f"effect {effect.name}: its traits are of type {type(effect.traits).__name__}"
        raise error(what, "make them with sim.declaration.proposal.Traits")


def _traits_of_older_form(effect: Any) -> Traits:
    sentences = (str(effect.sentence),) if hasattr(effect, "sentence") else ()
    return Traits(
        sentences,
        plausible=effect.plausible,
        onset=effect.onset,
        per_record=bool(effect.per_record),
    )


def _listed(signals: Sequence[Signal]) -> str:
    return ", ".join(signal.name for signal in signals) or "none"


def settings_of(effort: str) -> TraceSettings:
    """Return the settings of the tracing loop for an effort; raise DeclarationError for an unknown
    effort.
    """
    if effort not in EFFORTS:
        raise DeclarationError(
            f"there is no effort {effort!r}", where="--effort", remedy=f"use {' or '.join(EFFORTS)}"
        )
    return EFFORTS[effort]


def effort_sentence(effort: str, diagnosis: Diagnosis) -> str:
    """Return a sentence on the effort of the search.

    If the search used all its fits without explaining the residual, the sentence says whether a
    greater effort exists.
    """
    unexplained = diagnosis.verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)
    if not (diagnosis.stopped and unexplained):
        return f"effort: {effort}"
    further = "there is no greater effort"
    if effort == NORMAL.effort:
        further = "--effort thorough would look further"
    return (
        f"effort: {effort}; the search used all its fits, and the residual is not explained: "
        f"{further}"
    )


def at_bounds(diagnosis: Diagnosis, constraints: Constraints) -> tuple[Diagnosis, tuple[str, ...]]:
    """Return the diagnosis with sigma 0, printed as "at its bound", for each parameter at a bound,
    and a sentence on each.
    """
    before, after = (
        _names_at_bounds(values, constraints.bounds)
        for values in (diagnosis.before, diagnosis.after)
    )
    sentences = []
    for name in dict.fromkeys([*before, *after]):
        models = []
        if name in before:
            models.append("with the declared model")
        if name in after:
            models.append("with what was found")
        value = (diagnosis.before if name in before else diagnosis.after)[name].value
        sentences.append(
            f"{name} is at its bound {value:g}, {' and '.join(models)}: it has no sigma"
        )
    if not sentences:
        return diagnosis, ()
    return replace(
        diagnosis,
        before=_without_sigma(diagnosis.before, before),
        after=_without_sigma(diagnosis.after, after),
    ), tuple(sentences)


def _names_at_bounds(
    values: Mapping[str, Quantity], bounds: Mapping[str, tuple[float, float]]
) -> list[str]:
    return [
        name
        for name, limits in bounds.items()
        if name in values and side_at(values[name].value, limits)
    ]


def _without_sigma(values: Mapping[str, Quantity], names: list[str]) -> dict[str, Quantity]:
    return {
        name: replace(value, std=0.0) if name in names else value for name, value in values.items()
    }


@dataclass(frozen=True, eq=False)
class OpenedFiles:
    """Files of a request after reading; each file is read once."""

    vehicle: VehicleFile
    choices: Mapping[str, ColumnChoice] | None
    records: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]
    flown: FlightPhase


@dataclass(frozen=True, eq=False)
class LoopInput:
    """Model and records of the tracing loop.

    Attributes
    ----------
    model : the declared model.
    records, predicted : fitted and predicted records.
    fitted, validation : names and hashes of their files.
    held_out_from : time (s) from which the last record is held out; None if whole records are.
    notes, doubts : sentences on the preparation and on likely faults of the files.
    look : check of the raw columns.
    parted : each predicted record with the number of its parts in ``predicted``; empty if a part
        of ``records`` is held out.
    measured : the fitted records with all measured channels.
    """

    model: Model
    records: tuple[Record, ...]
    predicted: tuple[Record, ...]
    fitted: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    held_out_from: float | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    look: RecordCheck
    parted: tuple[PartedRecord, ...] = ()
    measured: tuple[Record, ...] = ()


def opened_files(request: Request, vehicle: Path | Source | None) -> OpenedFiles:
    """Open vehicle, class and category, channel map and records, in this order."""
    declared = read_vehicle(vehicle, request.model)
    flown = declared_phase(request, declared)
    choices = column_choices(
        request, channel_units(declared.own) if declared.own is not None else CHANNEL_UNITS
    )
    return OpenedFiles(
        declared, choices, *read_with_validation(request.records, request.validate), flown
    )


def loop_input_for(opened: OpenedFiles, plan: Plan) -> LoopInput:
    """Return the declared model with biases, the records prepared for it, and the held-out part.

    Raise an error for records without information.
    """
    from scenarios.preparation import plausibility
    from scenarios.preparation.declared_model import model_of_file
    from scenarios.preparation.reading import prepare, refuse_unfit_records

    model = model_of_file(opened.vehicle).with_noise(Noise())
    prepared = prepare(
        opened.records, model, plan, opened.choices, opened.validation, attitude=True
    )
    plausibility.refuse_unrelated_records(prepared.fitted, prepared.validation)
    records, notes = prepared.fitted, prepared.notes
    model = prepared.model.with_biases(_outputs_with_bias(prepared.model, records))
    plausibility.refuse_too_few(records, model)
    fitted, predicted, held_out_from = records, prepared.validation, None
    fitted_files, predicted_files = opened.records, opened.validation
    if not opened.validation:
        split = split_off(records, model)
        fitted, predicted, held_out_from = split.fitted, (split.held_out,), split.cut
        notes = (split.sentence, *notes)
        record_a_file = len(plan.segments) == 1 and len(records) == len(opened.records)
        if held_out_from is None and record_a_file:
            fitted_files, predicted_files = opened.records[:-1], opened.records[-1:]
    refuse_unfit_records(records, model)
    plausibility.refuse_still(records, model)
    plausibility.refuse_unpredictable(prepared.predicted, model)
    outputs = tuple(dict.fromkeys(name for record in records for name in record.output_names))
    notes = (*notes, *plausibility.not_recorded(outputs, prepared.predicted))
    return LoopInput(
        model,
        fitted,
        predicted,
        identities(fitted_files),
        identities(predicted_files),
        held_out_from,
        notes,
        prepared.doubts,
        prepared.look,
        prepared.parted,
        tuple(prepared.measured),
    )


def own_effects(
    given: Path | Sequence[Traceable] | None, model: Model
) -> tuple[tuple[Traceable, ...], tuple[InputFile, ...]]:
    """Return a user's effects that can act on the model, and their file; effects given as objects
    have none.
    """
    if given is None:
        return (), ()
    if not isinstance(given, Path):
        return checked_effects(given, model, "effects"), ()
    source = read_source(given, DeclarationError, "a Python file")
    return read_effects(source, model), (source.identity,)


def _outputs_with_bias(model: Model, records: Sequence[Record]) -> list[str]:
    measured = {name for record in records for name in record.output_names}
    return outputs_with_bias(
        model, [signal.name for signal in model.equations.outputs if signal.name in measured]
    )


def vehicle_path_of(request: Request) -> Path | Source | None:
    """Return the vehicle file; None if a user's own model has none."""
    first = request.records[0]
    chosen = request.vehicle if request.vehicle is not None else vehicle_next_to(first)
    if chosen is None and not is_model_file(request.model):
        record_path = path_of(first)
        record = record_path.name if record_path else "the record"
        raise DeclarationError(
            f"the {request.model} model needs constants and starting values",
            where="--vehicle",
            remedy=f"name a vehicle file, or put {VEHICLE_FILE_NAME} beside {record}",
        )
    return chosen


CHOOSE = "--hold linear or --hold previous says which"
READ_AGAIN = "what was found is likelier so than with held ones; --hold previous holds them"


@dataclass(eq=False)
class InputReading:
    """A second reading of the inputs of a diagnosis: linear between samples instead of held.

    Attributes
    ----------
    opened, plan : the files, and how they are read.
    linear : input of the loop with linear inputs; None until it is requested.
    """

    opened: OpenedFiles
    plan: Plan
    linear: LoopInput | None = field(default=None, init=False)

    @property
    def undeclared(self) -> bool:
        """Whether neither options nor files say how inputs move between samples."""
        files = (*self.opened.records, *self.opened.validation)
        return self.plan.hold is None and not any(file.sidecar.states_hold for file in files)

    def linear_input(self) -> LoopInput:
        """Return the input of the loop with linear inputs."""
        if self.linear is None:
            self.linear = loop_input_for(self.opened, replace(self.plan, hold=Hold.LINEAR))
        return self.linear

    def linear_data(self, loop_input: LoopInput) -> Callable[[], Data] | None:
        """Return a function that the loop calls for the records with linear inputs; None if the
        inputs are linear already or the reading is declared.
        """
        held = all(record.hold is Hold.PREVIOUS for record in loop_input.records)
        if not (self.undeclared and held):
            return None

        def data() -> Data:
            linear = self.linear_input()
            return linear.records, linear.predicted

        return data

    def with_better_reading(
        self, held: LoopInput, diagnosis: Diagnosis, run_loop: Callable[[LoopInput], Diagnosis]
    ) -> tuple[LoopInput, Diagnosis]:
        """Return the input of the loop and the diagnosis for the more likely reading.

        If effects have delays or time constants, the fitted model is fitted to both readings. If
        linear inputs are clearly more likely, the loop runs again with them.
        """
        fitted_linear = any(fit.record.hold is Hold.LINEAR for fit in diagnosis.fitted)
        if self.linear is not None and fitted_linear:
            return replace(self.linear, notes=notes_of_reread(self.linear.notes)), diagnosis
        if not self.undeclared or not has_fitted_times(diagnosis, held.records):
            return held, diagnosis
        linear = self.linear_input()
        refit = refit_with_linear(diagnosis, held.model, held.records, linear.records)
        if refit.rise > DECISIVE_LOG_LIKELIHOOD_RATIO:
            return replace(linear, notes=notes_of_reread(linear.notes)), run_loop(linear)
        diagnosis, sentences = with_sigmas_of_both(refit, diagnosis)
        return replace(held, notes=(*held.notes, *sentences)), diagnosis


def has_fitted_times(diagnosis: Diagnosis, records: Sequence[Record]) -> bool:
    """Return whether inputs are held and an effect of the fitted model has a time as parameter.

    Held inputs shift such a time by half a sampling interval.
    """
    if any(record.hold is not Hold.PREVIOUS for record in records):
        return False
    trained = diagnosis.trained_after
    # A hint may belong to another set than the fitted one.
    return any(
        name in TIMES
        for claim in diagnosis.effects
        if trained is None or claim.name in {effect.name for effect in trained.effects}
        for name in claim.parameters
    )


@dataclass(frozen=True)
class Refit:
    """The fitted model of a diagnosis, fitted again with linear inputs.

    Attributes
    ----------
    rise : increase of twice the log likelihood; minus infinity if a fit fails.
    values : parameters of the effects and of the declared model, by full name.
    """

    rise: float
    values: Mapping[str, float]


def refit_with_linear(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> Refit:
    """Fit the final model of a diagnosis to both readings of the inputs."""
    from ident.tracing.fitted_model import FitData, Start, Values, fit_set

    fitted = diagnosis.trained_after
    if fitted is None:
        return Refit(-math.inf, {})
    fits = []
    for records in (held, linear):
        masks = [record.output_array(fitted.outputs)[1] for record in records]
        data = FitData(records, masks, model, fitted.outputs)
        start = Start(Values(fitted.shared, fitted.own, ()))
        fits.append(fit_set(data, fitted.effects, fitted.settings, start))
    held_fit, linear_fit = fits
    if held_fit is None or linear_fit is None or not math.isfinite(linear_fit.fit.cost):
        return Refit(-math.inf, {})
    rise = 2.0 * (held_fit.fit.cost - linear_fit.fit.cost)
    return Refit(rise, linear_fit.values.shared)


def with_sigmas_of_both(refit: Refit, diagnosis: Diagnosis) -> tuple[Diagnosis, tuple[str, ...]]:
    """Return the diagnosis with sigmas that cover both readings of the inputs, and a sentence.

    Values remain those of held inputs; each reading is weighted by its likelihood. The diagnosis
    is unchanged if one reading is clearly more likely or no value changes by more than its sigma.
    """
    if abs(refit.rise) > DECISIVE_LOG_LIKELIHOOD_RATIO:
        return diagnosis, ()
    linear_share = 1.0 / (1.0 + math.exp(-0.5 * refit.rise))
    changes: list[str] = []

    def widened(prefix: str, quantities: Mapping[str, Quantity]) -> dict[str, Quantity]:
        result = dict(quantities)
        for name, held in quantities.items():
            linear = refit.values.get(prefix + name, held.value)
            if abs(linear - held.value) > held.std:
                changes.append(f"{prefix}{name} {linear:.4g} for {held.value:.4g}")
            std = math.hypot(held.std, math.sqrt(linear_share) * (linear - held.value))
            result[name] = replace(held, std=std)
        return result

    effects = tuple(
        replace(effect, parameters=widened(f"{effect.name}.", effect.parameters))
        for effect in diagnosis.effects
    )
    after = widened("", diagnosis.after)
    if not changes:
        return diagnosis, ()
    note = (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(changes)}; standard deviations hold both: {CHOOSE}"
    )
    return replace(diagnosis, effects=effects, after=after), (note,)


def notes_of_reread(notes: Sequence[str]) -> tuple[str, ...]:
    """Return notes that say that the fit chose the reading, not the user."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
