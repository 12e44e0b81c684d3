"""The model that a study keeps, on another record: parameters and effects frozen, initial states, gauge biases and events fitted."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.tracing.diagnosis import ErrorFigures
from ident.tracing.later_record import predict
from scenarios.diagnosis.candidates import checked_effects, read_effects
from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.files.channels import read_channel_map
from scenarios.files.measured.record_file import RecordFile, all_simulated, opened
from scenarios.files.own_models import OwnModel, channel_units
from scenarios.files.sources import InputFile, read_source
from scenarios.files.vehicles import VehicleFile, read_beside, read_vehicle
from scenarios.identification.assessment.prediction import pooled_fits, record_fits
from scenarios.identification.gravity import PATH, with_weight
from scenarios.identification.wild_points import left_out, with_wild_points, without
from scenarios.kept.kept_model import DIAGNOSE, KeptFile, KeptModel, read_kept
from scenarios.preparation.gaps import put_together
from scenarios.preparation.plan import ATTITUDE, Plan
from scenarios.preparation.plausibility import refuse_unpredictable
from scenarios.preparation.reading import Decided, Prepared, prepare
from scenarios.preparation.vehicle_model import model_of_file
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, RecordError
from sim.record import Hold, Record


@dataclass(frozen=True)
class Asked:
    """What a prediction is asked: a study folder, a record and how its columns are named; ``model`` and ``effects`` are a user's files, run,
    or what such files hold.
    """

    study: Path
    record: Path | RecordFile
    channels: Path | Mapping[str, Any] | None = None
    plan: Plan = field(default_factory=Plan)
    model: Path | OwnModel | None = None
    effects: Path | tuple[Traceable, ...] | None = None


@dataclass(frozen=True, eq=False)
class Simulation:
    """One free simulation of the record: ``rows`` ``(m, N)`` of its channels, and their errors; None where it left all measure."""

    rows: np.ndarray
    figures: ErrorFigures | None

    def fit_percent(self, channel: str) -> float:
        """100 (1 - rms error over the spread of the measurement)."""
        assert self.figures is not None
        return 100.0 * (1.0 - self.figures.nrmse[channel])


@dataclass(frozen=True, eq=False)
class Prediction:
    """A record predicted by a study's model: ``after`` with what the study found; ``before``, of a diagnosis, as declared.

    ``simulated``: a program made the record, by what the JSON beside it says.
    """

    study: Path
    kept: KeptModel
    vehicle: str
    record: Record
    source: InputFile
    channels: tuple[str, ...]
    after: Simulation
    before: Simulation | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    simulated: bool = False


def predict_record(asked: Asked) -> Prediction:
    """Read the study's model and the record, and simulate.

    Raises
    ------
    DeclarationError : the folder keeps no model; a file of the user's that it rests on is not named, or is another one.
    RecordError : anything in the record that keeps it from being used.
    """
    file = read_kept(asked.study)
    vehicle = _vehicle(file, asked.model)
    model = model_of_file(vehicle)
    kept = file.model(_own_effects(file, asked.effects, model))
    source = opened(asked.record)
    known = channel_units(vehicle.own) if vehicle.own is not None else CHANNEL_UNITS
    choices = read_channel_map(asked.channels, known) if asked.channels is not None else None
    reading, plan = kept.reading, _plan(kept, asked.plan)
    model = model.with_noise(Noise()) if kept.made_by == DIAGNOSE else model
    decided = Decided(Hold(reading.hold), reading.weight)
    ready = prepare((), model, plan, choices, [source], flow=reading.flow, attitude=reading.attitude, decided=decided, part=plan.segments[0])
    (record,), declared = ready.predicted, ready.model
    _refuse_without_attitude(kept, declared, record)
    refuse_unpredictable([record], declared, "")
    channels = tuple(name for name in kept.after.outputs if name in record.output_names)
    if not channels:
        remedy = f"the study's outputs are {', '.join(kept.after.outputs)}; map the columns with --channels"
        raise RecordError("it has none of the study's outputs", where=str(source.path), remedy=remedy)
    by = _by_diagnosis if kept.made_by == DIAGNOSE else _by_identification
    record, before, after, counted = by(kept, declared, ready, trusted=plan.trusted)
    masks = [left_out(*pair) for pair in zip(ready.validation, counted, strict=True)]
    ready = replace(ready, look=with_wild_points(ready.look, ready.validation, masks))
    return Prediction(
        asked.study,
        kept,
        vehicle.name,
        record,
        source.identity,
        channels,
        after,
        before,
        (*read_beside([source], None), *ready.notes),
        _warnings(ready),
        all_simulated([source]),
    )


def _by_identification(
    kept: KeptModel, declared: Model, ready: Prepared, *, trusted: bool
) -> tuple[Record, Simulation | None, Simulation, list[Record]]:
    """As ``identify --validate`` predicts: the record, the simulations before and after, and its
    parts less their wild points."""
    model = with_weight(declared) if kept.weighed else declared
    system = compile_model(model.with_biases(kept.biases), kept.after.outputs)
    fits = record_fits([], ready.validation, system, kept.after.shared, kept.after.settings, [PATH], trusted=trusted)
    (fit,) = pooled_fits(fits, ready.parted)
    at = [fit.outputs.index(name) for name in fit.outputs if name in fit.record.output_names]
    return fit.record, None, Simulation(fit.simulated[at], fit.figures), [each.record for each in fits]


def _by_diagnosis(kept: KeptModel, declared: Model, ready: Prepared, *, trusted: bool) -> tuple[Record, Simulation | None, Simulation, list[Record]]:
    """As ``diagnose --validate`` predicts, which looks for wild points in any record."""
    assert kept.before is not None
    found = predict(kept.before, kept.after, declared.with_biases(kept.biases), ready.validation, kept.spiked)
    (whole,) = ready.parted
    rows = [[each.before for each in found.predictions], [each.after for each in found.predictions]]
    record, (before, after) = put_together(whole, ready.validation, rows)
    channels = found.predictions[0].channels
    wild = [
        {name: ~mask[row] & part[name].valid for row, name in enumerate(channels)} for part, mask in zip(ready.validation, found.counted, strict=True)
    ]
    parts = [without(part, masks) for part, masks in zip(ready.validation, wild, strict=True)]
    return record, Simulation(before, found.before), Simulation(after, found.after if found.finite else None), parts


def _vehicle(file: KeptFile, model: Path | OwnModel | None) -> VehicleFile:
    """The study's vehicle, from the text that it keeps; of a user's own model with the file that is named again."""
    own, text = file.file("model_file"), file.content["vehicle_text"]
    chosen: str | OwnModel = file.content["model"]
    if own is not None:
        if model is None:
            what = f"the study's model is that of {own.name}, a file of a user's own, which is run only when it is named"
            raise DeclarationError(what, where="--model", remedy=f"add --model PATH/{own.name}")
        chosen = model if isinstance(model, OwnModel) else _same(model, own, "--model")
        if isinstance(model, OwnModel) and model.identity.sha256 != own.sha256:
            what = f"{model.model.name} is not the {own.name} that the study was made with"
            raise DeclarationError(what, where="--model", remedy="give that model as it was, or run the study again")
    elif model is not None:
        raise DeclarationError(f"the study's model is {chosen}, which is built in", where="--model", remedy="leave it out")
    if not text:
        return read_vehicle(None, chosen)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        entry = file.file("vehicle")
        # A study may be somebody else's: whatever name it gives its vehicle file, nothing is written outside this folder.
        named = Path(entry.name).name.lstrip(".") if entry is not None else ""
        path = Path(folder) / (named or "vehicle.toml")
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
        return read_vehicle(path, chosen)


def _own_effects(file: KeptFile, effects: Path | tuple[Traceable, ...] | None, model: Model) -> Sequence[Traceable]:
    known = file.file("effects_file")
    if effects is None:
        return ()
    if not isinstance(effects, Path):
        return checked_effects(effects, model, "effects")
    if known is None:
        raise DeclarationError("the study was made without effects of one's own", where="--effects", remedy="leave it out")
    return read_effects(_same(effects, known, "--effects"), model)


def _same(path: Path, known: InputFile, option: str) -> str:
    """The path of a user's file; refused where it is not the one that the study was made with, to the byte."""
    if read_source(path, DeclarationError, "a Python file").identity.sha256 != known.sha256:
        what = f"{path} is not the {known.name} that the study was made with"
        raise DeclarationError(what, where=option, remedy="name that file as it was, or run the study again")
    return str(path)


def _plan(kept: KeptModel, asked: Plan) -> Plan:
    """The study's preparation, and of the record the part that is asked."""
    reading = kept.reading
    hold = Hold(reading.hold) if reading.by_hand else None
    trusted = reading.trusted or asked.trusted
    return Plan(asked.segments, hold, asked.rate or reading.rate or None, reading.lowpass or None, trusted, asked.columns, asked.chosen)


def _refuse_without_attitude(kept: KeptModel, declared: Model, record: Record) -> None:
    """A model that takes the pitch attitude from the record needs one there."""
    takes = kept.weighed or any(getattr(effect, "attitude_recorded", False) for effect in kept.after.effects)
    if takes and ATTITUDE not in {signal.name for signal in declared.equations.inputs}:
        what = "it has no theta, which the study's model takes as it is recorded"
        raise RecordError(what, where=record.name, remedy="give a record with theta, or make the study without it")


def _warnings(ready: Prepared) -> tuple[str, ...]:
    return (*ready.doubts, *ready.look.set_aside)


def figures_of(simulation: Simulation) -> Mapping[str, Mapping[str, float]]:
    """rms error, fit in per cent, R squared and Theil's coefficient by channel; empty where the simulation left all measure."""
    f = simulation.figures
    if f is None:
        return {}
    return {
        name: {"rms_error": error, "fit_percent": simulation.fit_percent(name), "r2": f.r2[name], "theil": f.theil[name]}
        for name, error in f.rmse.items()
    }
