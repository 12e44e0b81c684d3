"""What a diagnosis is given: effort, records, candidate effects, bounds, inputs between samples."""

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
from scenarios.files.declarations import CHANNEL_UNITS, WANTED, run_python
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
from scenarios.files.vehicles import BESIDE_RECORD, VehicleFile, read_vehicle, vehicle_next_to
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
    from scenarios.preparation.reading import PreparedData

Act = TypeVar("Act", bound=Effect)

_ATTRIBUTES = (
    "name",
    "station",
    "parameters",
    "absent",
    "regularity",
    "aliases",
    "explanation",
    "probes",
)
# stood with the effect itself before ``traits`` did
_FORMERLY = ("onset", "per_record", "plausible")


def candidates_for(model: Model, own: Sequence[Traceable] = ()) -> tuple[Traceable, ...]:
    """Return library effects that can act on a model and are not in it, then the user's ``own``."""
    from sim.effects.library import effects_for

    equations = model.equations
    taken = {effect.name for effect in model.effects} | {
        *(equations.contains if isinstance(equations, Containing) else ())
    }
    recorded = {signal.name for signal in equations.inputs}
    offered = can_act(effects_for(equations), model)
    found = (
        effect for effect in offered if effect.name not in taken and isinstance(effect, Traceable)
    )
    known = (effect for effect in found if effect.traits.recorded_as not in recorded)
    return (*(effect for effect in known if _may_change(effect, model)), *own)


def _may_change(effect: Effect, model: Model) -> bool:
    """Return whether the parameters that an effect varies are estimated."""
    changed = (
        (effect.parameter,)
        if isinstance(effect, ParameterEffect)
        else effect.group
        if isinstance(effect, GroupEffect)
        else ()
    )
    return all(model.parameters[name].free for name in changed)


def can_act(effects: Sequence[Act], model: Model) -> tuple[Act, ...]:
    """Return the effects whose signals exist in a model; user models may lack some of them."""
    return tuple(effect for effect in effects if not is_own(model) or _acts(effect, model))


def _acts(effect: Effect, model: Model) -> bool:
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
        return True  # no value at rest is no lack of a signal
    return True


def read_effects(source: str | Path | Source, model: Model) -> tuple[Traceable, ...]:
    """Return the effects of a user's Python file, or of one that was read, that can act on a model:
    its ``EFFECTS``, else its ``VARIANTS``.

    The file is run, once, as any Python program is: only a file that the user names comes here.

    Raises
    ------
    DeclarationError : no such file, an error in it (with its line), no effects in it, an effect
        that lacks an attribute or has the name of one in the library, or none that can act on this
        model.
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
    return checked_effects(effects, model, where)


def checked_effects(effects: Sequence[Any], model: Model, where: str) -> tuple[Traceable, ...]:
    """Return a user's effects that can act on a model; ``where``: their place, for messages. Raises
    DeclarationError as ``read_effects``.
    """
    from sim.effects.library import applies, library

    known = {effect.name for effect in library()}
    for effect in effects:
        _check(effect, where)
        if effect.name in known:
            raise DeclarationError(
                f"effect {effect.name}: the library has one of this name",
                where=where,
                remedy="give yours another name",
            )
    able = tuple(effect for effect in effects if applies(effect, model.equations))
    if not able:
        named = ", ".join(dict.fromkeys(effect.name for effect in effects))
        e = model.equations
        remedy = (
            f"its inputs are {_listed(e.inputs)}, its outputs {_listed(e.outputs)}, its ports "
            f"{_listed(e.ports)}"
        )
        raise DeclarationError(
            f"no effect of it ({named}) can act on the {model.equations.name} model",
            where=where,
            remedy=remedy,
        )
    able_names = [effect.name for effect in able]
    for name in able_names:
        if able_names.count(name) > 1:
            raise DeclarationError(
                f"effect {name} is there twice", where=where, remedy="give each a name of its own"
            )
    return able


def _check(effect: Any, where: str) -> None:
    """Raise an error for a value that is no effect; add traits to effects of the former form."""

    def fault(what: str, remedy: str) -> DeclarationError:
        return DeclarationError(what, where=where, remedy=remedy)

    kind = type(effect).__name__
    if isinstance(effect, type):
        remedy = f"put an instance into EFFECTS: {effect.__name__}(...)"
        raise fault(f"{effect.__name__} is a class", remedy)
    wanted = _ATTRIBUTES if hasattr(effect, "traits") else (*_ATTRIBUTES, *_FORMERLY)
    missing = [attribute for attribute in wanted if not hasattr(effect, attribute)]
    if missing == [*wanted]:
        raise fault(
            f"{effect!r:.60} is a {kind}, not an effect",
            "leave effects of the library out, diagnose tries them all; of your own give objects "
            "or the path of their file, as docs/how-to/own-effect.md shows",
        )
    if missing == [*_FORMERLY]:
        missing = ["traits"]
    if missing:
        named = getattr(effect, "name", "")
        shown = named if isinstance(named, str) and named else kind
        remedy = "add it as docs/how-to/own-effect.md shows"
        raise fault(f"effect {shown} lacks {', '.join(missing)}", remedy)
    if hasattr(effect, "traits") and not isinstance(effect.traits, Traits):
        remedy = "make them with sim.declaration.proposal.Traits"
        what = f"effect {effect.name}: its traits are of type {type(effect.traits).__name__}"
        raise fault(what, remedy)
    if not hasattr(effect, "traits"):
        # On the class, so that copies of the effect have it, too.
        type(effect).traits = property(_former_traits)


def _former_traits(effect: Any) -> Traits:
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
    """Return the settings of the loop for an effort; DeclarationError, in one line, for one that
    there is not.
    """
    if effort not in EFFORTS:
        raise DeclarationError(
            f"there is no effort {effort!r}", where="--effort", remedy=f"use {' or '.join(EFFORTS)}"
        )
    return EFFORTS[effort]


def effort_sentence(effort: str, diagnosis: Diagnosis) -> str:
    """Return a sentence on the effort made, and whether a greater one would look further: if a
    search used all its fits and the residual is not explained.
    """
    if not (diagnosis.stopped and diagnosis.verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)):
        return f"effort: {effort}"
    further = (
        "--effort thorough would look further"
        if effort == NORMAL.effort
        else "there is no greater effort"
    )
    return (
        f"effort: {effort}; the search used all its fits, and the residual is not explained: "
        f"{further}"
    )


def at_bounds(diagnosis: Diagnosis, constraints: Constraints) -> tuple[Diagnosis, tuple[str, ...]]:
    """Return the diagnosis with a sigma of zero, which is printed as a bound, for each parameter
    that ended at one; a sentence on each.
    """
    before, after = (
        _pressed(side, constraints.bounds) for side in (diagnosis.before, diagnosis.after)
    )
    sentences = []
    for name in dict.fromkeys([*before, *after]):
        sides = [
            word
            for word, names in (("with the declared model", before), ("with what was found", after))
            if name in names
        ]
        value = (diagnosis.before if name in before else diagnosis.after)[name].value
        sentences.append(
            f"{name} is at its bound {value:g}, {' and '.join(sides)}: it has no sigma"
        )
    if not sentences:
        return diagnosis, ()
    return replace(
        diagnosis, before=_held(diagnosis.before, before), after=_held(diagnosis.after, after)
    ), tuple(sentences)


def _pressed(
    values: Mapping[str, Quantity], bounds: Mapping[str, tuple[float, float]]
) -> list[str]:
    return [
        name
        for name, pair in bounds.items()
        if name in values and side_at(values[name].value, pair)
    ]


def _held(values: Mapping[str, Quantity], names: list[str]) -> dict[str, Quantity]:
    return {
        name: replace(each, std=0.0) if name in names else each for name, each in values.items()
    }


@dataclass(frozen=True, eq=False)
class Opened:
    """Everything that was read for a request, each file once."""

    vehicle: VehicleFile
    choices: Mapping[str, ColumnChoice] | None
    records: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]
    flown: FlightPhase


@dataclass(frozen=True, eq=False)
class Posed:
    """What the loop is given of the records, and which files that is: ``fitted`` and ``validation``
    hold their names and hashes.

    ``parted``: records that are predicted, each with the number of its parts in ``predicted``;
    none if something is held out of ``records``. ``measured``: the fitted records with all that
    they measure.
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


def opened_files(request: Request, vehicle: Path | Source | None) -> Opened:
    """Open vehicle, class and category, channel map and records, in this order."""
    declared = read_vehicle(vehicle, request.model)
    flown = declared_phase(request, declared)
    choices = column_choices(
        request, channel_units(declared.own) if declared.own is not None else CHANNEL_UNITS
    )
    return Opened(
        declared, choices, *read_with_validation(request.records, request.validate), flown
    )


def posed_for(opened: Opened, plan: Plan) -> Posed:
    """Return records prepared for the declared model with biases, and the held-out part.

    Raises an error for records without information.
    """
    from scenarios.preparation import plausibility
    from scenarios.preparation.declared_model import model_of_file
    from scenarios.preparation.reading import refuse_unfit_records

    ready = _ready(opened, model_of_file(opened.vehicle).with_noise(Noise()), plan)
    whole, predicted, notes, held_out_from = ready.fitted, ready.validation, ready.notes, None
    model = ready.model.with_biases(_biased(ready.model, whole))
    plausibility.refuse_too_few(whole, model)
    fitted, files = whole, (opened.records, opened.validation)
    if not opened.validation:
        split = split_off(whole, model)
        fitted, predicted, held_out_from, notes = (
            split.fitted,
            (split.held_out,),
            split.cut,
            (split.sentence, *notes),
        )
        if held_out_from is None and len(plan.segments) == 1 and len(whole) == len(opened.records):
            files = (opened.records[:-1], opened.records[-1:])
    refuse_unfit_records(whole, model)
    plausibility.refuse_still(whole, model)
    plausibility.refuse_unpredictable(ready.predicted, model)
    outputs = tuple(dict.fromkeys(name for record in whole for name in record.output_names))
    notes = (*notes, *plausibility.not_recorded(outputs, ready.predicted))
    return Posed(
        model,
        fitted,
        predicted,
        identities(files[0]),
        identities(files[1]),
        held_out_from,
        notes,
        ready.doubts,
        ready.look,
        ready.parted,
        tuple(ready.measured),
    )


def _ready(opened: Opened, model: Model, plan: Plan) -> PreparedData:
    from scenarios.preparation.plausibility import refuse_unrelated_records
    from scenarios.preparation.reading import prepare

    ready = prepare(opened.records, model, plan, opened.choices, opened.validation, attitude=True)
    refuse_unrelated_records(ready.fitted, ready.validation)
    return ready


def own_effects(
    given: Path | Sequence[Traceable] | None, model: Model
) -> tuple[tuple[Traceable, ...], tuple[InputFile, ...]]:
    """Return a user's effects that can act on the model, and the file that they came from, if they
    came from one.
    """
    if given is None:
        return (), ()
    if not isinstance(given, Path):
        return checked_effects(given, model, "effects"), ()
    source = read_source(given, DeclarationError, "a Python file")
    return read_effects(source, model), (source.identity,)


def _biased(model: Model, records: Sequence[Record]) -> list[str]:
    """Return the measured outputs whose sensors have a free bias."""
    measured = {name for record in records for name in record.output_names}
    return outputs_with_bias(
        model, [signal.name for signal in model.equations.outputs if signal.name in measured]
    )


def vehicle_path_of(request: Request) -> Path | Source | None:
    """Return the vehicle file, None if an own model goes without one."""
    first = request.records[0]
    chosen = request.vehicle if request.vehicle is not None else vehicle_next_to(first)
    if chosen is None and not is_model_file(request.model):
        what = f"the {request.model} model needs constants and starting values"
        raise DeclarationError(
            what,
            where="--vehicle",
            remedy=(
                f"name a vehicle file, or put {BESIDE_RECORD} beside "
                f"{path.name if (path := path_of(first)) else 'the record'}"
            ),
        )
    return chosen


def _name_of(record: Path | RecordFile) -> str:
    path = path_of(record)
    return path.name if path is not None else "a record file"


CHOOSE = "--hold linear or --hold previous says which"
READ_AGAIN = "what was found is likelier so than with held ones; --hold previous holds them"


@dataclass(eq=False)
class InputReading:
    """The other reading of the inputs of a diagnosis: linear between samples, prepared when it is
    requested.

    Attributes
    ----------
    opened, plan : the files, and how they are read.
    linear : what the loop is given with linear inputs, once it was requested.
    """

    opened: Opened
    plan: Plan
    linear: Posed | None = field(default=None, init=False)

    @property
    def open(self) -> bool:
        """Whether nobody said how inputs are to be read between samples."""
        files = (*self.opened.records, *self.opened.validation)
        return self.plan.hold is None and not any(file.sidecar.says_hold for file in files)

    def posed(self) -> Posed:
        """Problem of the loop, with linear inputs."""
        if self.linear is None:
            self.linear = posed_for(self.opened, replace(self.plan, hold=Hold.LINEAR))
        return self.linear

    def offered(self, posed: Posed) -> Callable[[], Data] | None:
        """The records that are fitted and those that are predicted, with linear inputs, for the
        loop to ask for; None if inputs are linear already, or where somebody said how they move.
        """
        if not self.open or any(record.hold is not Hold.PREVIOUS for record in posed.records):
            return None

        def data() -> Data:
            linear = self.posed()
            return linear.records, linear.predicted

        return data

    def settled(
        self, posed: Posed, diagnosis: Diagnosis, looped: Callable[[Posed], Diagnosis]
    ) -> tuple[Posed, Diagnosis]:
        """Return the diagnosis with the better reading of the inputs, and changes with the other.

        Delays found together with a model discrepancy are fitted to both readings. If the other
        is clearly more likely, the loop runs again.
        """
        taken = any(each.record.hold is Hold.LINEAR for each in diagnosis.fitted)
        if self.linear is not None and taken:
            return replace(self.linear, notes=read_again(self.linear.notes)), diagnosis
        if not self.open or not tells_times(diagnosis, posed.records):
            return posed, diagnosis
        linear = self.posed()
        refit = refitted(diagnosis, posed.model, posed.records, linear.records)
        if refit.rise > DECISIVE_LOG_LIKELIHOOD_RATIO:
            return replace(linear, notes=read_again(linear.notes)), looped(linear)
        diagnosis, told = left_open(refit, diagnosis)
        return replace(posed, notes=(*posed.notes, *told)), diagnosis


def tells_times(diagnosis: Diagnosis, records: Sequence[Record]) -> bool:
    """Return whether times were found that held inputs would shift by half an interval."""
    if any(record.hold is not Hold.PREVIOUS for record in records):
        return False
    return any(name in TIMES for found in diagnosis.effects for name in found.parameters)


@dataclass(frozen=True)
class Refit:
    """What was found, fitted again with inputs that move linearly between samples.

    ``rise`` : by how much twice the log likelihood rises; minus infinity where nothing fits.
    ``values`` : parameters of the effects and of the declared model, by full name.
    """

    rise: float
    values: Mapping[str, float]


def refitted(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> Refit:
    """Fit what was found to both readings of the inputs."""
    from ident.tracing.fitted_model import FitData, Start, Values, fit_set

    found = diagnosis.trained_after
    if found is None:
        return Refit(-math.inf, {})
    fits = []
    for records in (held, linear):
        masks = [record.output_array(found.outputs)[1] for record in records]
        data = FitData(records, masks, model, found.outputs)
        start = Start(Values(found.shared, found.own, ()))
        fits.append(fit_set(data, found.effects, found.settings, start))
    first, second = fits
    if first is None or second is None or not math.isfinite(second.fit.cost):
        return Refit(-math.inf, {})
    return Refit(2.0 * (first.fit.cost - second.fit.cost), second.values.shared)


def left_open(again: Refit, first: Diagnosis) -> tuple[Diagnosis, tuple[str, ...]]:
    """Return the diagnosis with sigmas that include the second reading, and sentences on it.

    Only if both readings fit about equally: each is weighted by its likelihood; values are those of
    the first. Otherwise the diagnosis is unchanged.
    """
    if abs(again.rise) > DECISIVE_LOG_LIKELIHOOD_RATIO:
        return first, ()
    share = 1.0 / (1.0 + math.exp(-0.5 * again.rise))
    moved: list[str] = []

    def widened(prefix: str, quantities: Mapping[str, Quantity]) -> dict[str, Quantity]:
        made = dict(quantities)
        for name, was in quantities.items():
            other = again.values.get(prefix + name, was.value)
            if abs(other - was.value) > was.std:
                moved.append(f"{prefix}{name} {other:.4g} for {was.value:.4g}")
            std = math.hypot(was.std, math.sqrt(share) * (other - was.value))
            made[name] = replace(was, std=std)
        return made

    effects = tuple(
        replace(found, parameters=widened(f"{found.name}.", found.parameters))
        for found in first.effects
    )
    after = widened("", first.after)
    if not moved:
        return first, ()
    note = (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(moved)}; standard deviations hold both: {CHOOSE}"
    )
    return replace(first, effects=effects, after=after), (note,)


def read_again(notes: Sequence[str]) -> tuple[str, ...]:
    """Return the sentences on a second reading, which no one chose by hand."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
