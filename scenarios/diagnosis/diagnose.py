"""The tracing loop on files: records, vehicle and candidates put together, something held out where no record is named for it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ident.tracing.diagnosis import Diagnosis, Verdict, Witness
from ident.tracing.settings import TraceSettings
from scenarios.diagnosis.candidates import candidates_for, read_effects
from scenarios.diagnosis.kinematics import Kinematics, kinematics_of_files
from scenarios.diagnosis.witness import KinematicWitness
from scenarios.files.channel_names import STICK
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.preparation.holding_out import split_off
from scenarios.preparation.plan import Plan
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.declaration.traits import Traits
from sim.errors import DeclarationError, RecordError
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.preparation.reading import Prepared

KINEMATIC = ("rigid", "flexible")  # models of records that are checked without aerodynamics beside the diagnosis
MODELS = ("ballistic", "rigid", "flexible", "loes")
BESIDE = "vehicle.toml"


class Trace(Protocol):
    """The tracing loop, ``ident.tracing.loop.diagnose``."""

    def __call__(
        self,
        records: Sequence[Record],
        model: Model,
        candidates: Sequence[Traceable],
        guards: Sequence[Traceable],
        validation: Sequence[Record],
        settings: TraceSettings,
        progress: Callable[[str, float], None],
        witness: Witness,
    ) -> Diagnosis: ...


@dataclass(frozen=True)
class InputFile:
    """A file that a diagnosis rests on: its bare name and the SHA-256 of its content."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Inputs:
    """All files that a diagnosis rests on; ``validation`` is empty where only a part of a file was held out, ``effects`` where none was named."""

    records: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    vehicle: InputFile
    effects: tuple[InputFile, ...] = ()


@dataclass(frozen=True, eq=False)
class Tracing:
    """A diagnosis with what it was made from.

    ``records`` and ``validation`` are what was fitted and what was predicted; ``held_out_from`` is the time (s) at which the last
    record was cut, None where whole records were predicted. ``explanations`` by effect name; ``own`` likewise: the traits of
    effects that are not the library's. ``notes`` say how the records were prepared, one sentence each; ``doubts`` what in
    the files is likely to be wrong. ``kinematics``: what the records say without any aerodynamics, None where it was not asked.
    """

    diagnosis: Diagnosis
    vehicle: VehicleFile
    model: Model
    records: tuple[Record, ...]
    validation: tuple[Record, ...]
    inputs: Inputs
    held_out_from: float | None = None
    explanations: dict[str, str] = field(default_factory=dict)
    own: dict[str, Traits] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    kinematics: Kinematics | None = None

    @property
    def stick_unit(self) -> str:
        """The stick's label, empty where there is no stick."""
        return next((channel.unit for channel in self.records[0].inputs if channel.name == STICK), "")


def diagnose_files(
    records: Sequence[Path],
    model: str,
    vehicle: Path | None = None,
    validate: Sequence[Path] = (),
    effects: Path | None = None,
    channels: Path | None = None,
    plan: Plan | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
    trace: Trace | None = None,
) -> Tracing:
    """Read everything, run the loop, and return its result with what went in.

    Parameters
    ----------
    records : files that are fitted. model : one of ``MODELS``.
    vehicle : constants and starting values; None takes ``vehicle.toml`` from the folder of the first record.
    validate : files that are predicted, whole. Without any, the last of several records is held out, and the last part of a single one
        (``split_off``).
    effects : a user's Python file; it is run.
    channels : a channel map, for all records.
    plan : segments of ``records`` (those of ``validate`` are not cut), and how all of them are prepared; None: whole, as the data say.
    progress : told the stage and the share done, 0 to 1. trace : the loop; None takes ``ident.tracing.loop.diagnose``.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used, in one line.
    """
    from scenarios.preparation.plausibility import refuse_degrees, refuse_still, refuse_unpredictable
    from scenarios.preparation.vehicle_model import model_of_file
    from sim.effects.library import guards_for

    if model not in MODELS:
        raise DeclarationError(f"there is no model {model!r}", where="--model", remedy=f"use one of {', '.join(MODELS)}")
    _refuse_twice([*records, *validate])
    vehicle_path = _vehicle_path(vehicle, records[0], model)
    progress("reading", 0.0)
    declared = read_vehicle(vehicle_path, model)
    full = model_of_file(declared).with_noise(Noise())
    plan = plan or Plan()
    ready = _read(records, validate, full, channels, plan)
    whole, predicted, notes = ready.fitted, ready.validation, ready.notes
    full = ready.model.with_biases(_biased(ready.model, whole))
    own = read_effects(effects, full) if effects is not None else ()
    fitted, held_out_from, files = whole, None, (records, validate)
    if not validate:
        split = split_off(whole, full)
        fitted, predicted, held_out_from, notes = split.fitted, (split.held,), split.cut, (split.sentence, *notes)
        if held_out_from is None and len(plan.segments) == 1:
            files = (records[:-1], records[-1:])
    refuse_degrees((*whole, *ready.validation))
    refuse_still(whole, full)
    refuse_unpredictable(ready.validation, full)
    candidates = candidates_for(full, own)
    run = trace or _loop()
    checked = [*records, *(validate if plan.segments == Plan().segments else ())]
    witness = KinematicWitness((lambda: kinematics_of_files(checked, declared, channels, plan)) if declared.model in KINEMATIC else None)
    diagnosis = run(fitted, full, candidates, guards_for(full.equations), predicted, TraceSettings(), progress, witness)
    return Tracing(
        diagnosis,
        declared,
        full,
        fitted,
        predicted,
        Inputs(_named(files[0]), _named(files[1]), _named([vehicle_path])[0], _named([effects] if effects is not None else [])),
        held_out_from,
        {effect.name: " ".join(effect.explanation.split()) for effect in candidates},
        {effect.name: effect.traits for effect in own},
        notes,
        ready.doubts,
        # Only a verdict that needs evidence is worth a check, which costs as much as some candidates.
        witness.kinematics if diagnosis.verdict is not Verdict.CONSISTENT else None,
    )


def _loop() -> Trace:
    from ident.tracing.loop import diagnose

    return diagnose


def _read(records: Sequence[Path], validate: Sequence[Path], model: Model, channels: Path | None, plan: Plan) -> Prepared:
    from scenarios.files.channels import read_channel_map
    from scenarios.preparation.reading import prepare

    ready = prepare(records, model, plan, read_channel_map(channels) if channels is not None else None, validate)
    _same_stick([*ready.fitted, *ready.validation])
    measured = {name for record in ready.fitted for name in record.output_names}
    for record in ready.validation:
        if not measured.intersection(record.output_names):
            known = ", ".join(sorted(measured))
            what = f"none of the fitted channels ({known}) is measured here"
            raise RecordError(what, where=record.name, remedy="validate on a record that has one of them")
    return ready


def _same_stick(records: Sequence[Record]) -> None:
    """The stick is never converted: numbers of two units must not meet in one call."""
    if STICK not in records[0].input_names:
        return
    first = records[0]
    for record in records[1:]:
        if record[STICK].unit != first[STICK].unit:
            what = f"the stick is in {_label(record[STICK].unit)}, in {first.name} it is in {_label(first[STICK].unit)}"
            raise RecordError(what, where=record.name, remedy="give all records of a call the stick in one unit: it is never converted")


def _label(unit: str) -> str:
    return "no unit" if unit in ("", "1") else repr(unit)


def _biased(model: Model, records: Sequence[Record]) -> list[str]:
    """Every measured output gets a bias, but an altitude: there it is the same as another ballistic coefficient."""
    measured = {name for record in records for name in record.output_names}
    return [signal.name for signal in model.equations.outputs if signal.name in measured and signal.name != "altitude"]


def _vehicle_path(vehicle: Path | None, record: Path, model: str) -> Path:
    if vehicle is not None:
        return vehicle
    beside = record.parent / BESIDE
    if not beside.is_file():
        what = f"the {model} model needs constants and starting values"
        raise DeclarationError(what, where="--vehicle", remedy=f"name a vehicle file, or put {BESIDE} beside {record.name}")
    return beside


def _refuse_twice(paths: Sequence[Path]) -> None:
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise RecordError("the record is named twice", where=str(path), remedy="name each record once, for the fit or for --validate")
        seen.add(path.resolve())


def _named(paths: Sequence[Path]) -> tuple[InputFile, ...]:
    return tuple(InputFile(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in paths)
