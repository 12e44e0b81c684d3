"""Prediction of another record by the stored model of a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.tracing.diagnosis import Quantity
from ident.tracing.predictive import predict
from scenarios.diagnosis.opening import checked_effects, read_effects
from scenarios.files.declarations import CHANNEL_UNITS, read_channel_map
from scenarios.files.measured.columns import RecordFile, all_simulated, opened
from scenarios.files.sources import InputFile, versions
from scenarios.files.user_models import OwnModel, channel_units
from scenarios.files.vehicles import files_read_unnamed, vehicle_with_file
from scenarios.files.writing import PREDICTED, csv_text, study_folder, write_json, write_text
from scenarios.identification.assessment import pooled_fits, record_fits
from scenarios.identification.conditions import PATH, with_weight
from scenarios.plots import draw_into
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.preparation.declared_model import model_of_file
from scenarios.preparation.filtering import put_together
from scenarios.preparation.plan import ATTITUDE, Plan
from scenarios.preparation.plausibility import not_recorded, refuse_unpredictable
from scenarios.preparation.reading import Decided, PreparedData, prepare
from scenarios.preparation.recording import left_out, with_outliers, without
from scenarios.report.document import (
    Bullets,
    Cell,
    Column,
    Page,
    Table,
    as_sentence,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.summary import WIDTH, wrapped
from scenarios.report.terminal import (
    FITS,
    NO_FIT,
    fit_cells,
    rows_table,
    table_as_lines,
    with_noise,
)
from scenarios.stored_study import (
    DIAGNOSE,
    StoredModel,
    StoredStudy,
    read_stored_study,
    unchanged_file,
    vehicle_of_study,
)
from scenarios.tolerances import (
    COLUMNS_NOTE,
    Simulation,
    ToleranceVerdict,
    error_against_fit,
    read_tests,
    residuals_of,
    sensor_noise_of,
    tolerance_content,
    tolerance_figures,
    tolerance_table,
    verdicts_of,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, RecordError
from sim.record import Hold, Record, extent

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named


# ---- Prediction with the stored model of a study


@dataclass(frozen=True)
class PredictionRequest:
    """Request of a prediction.

    Attributes
    ----------
    study : folder of the study.
    record : the record to predict.
    channels : channel map, or its path.
    plan : preparation of the record.
    model : file of the user's model that the study used, or its content.
    effects : file of the user's effects that the study used, or the effects.
    tolerances : tests of simulator qualification, see `scenarios.tolerances.read_tests`.
    """

    study: Path
    record: Path | RecordFile
    channels: Path | Mapping[str, Any] | None = None
    plan: Plan = field(default_factory=Plan)
    model: Path | OwnModel | None = None
    effects: Path | tuple[Traceable, ...] | None = None
    tolerances: str | None = None


@dataclass(frozen=True, eq=False)
class PredictionResult:
    """A record predicted by a study's model.

    Attributes
    ----------
    study : folder of the study.
    stored : stored model of the study.
    vehicle : name of the vehicle.
    record, source : the record, and name and hash of its file.
    channels : predicted outputs that the record has.
    after : simulation with the identified model.
    before : simulation with the declared model of a diagnosis; None for an identification.
    notes, warnings : sentences for the user.
    simulated : whether the record is simulated, according to its JSON file.
    verdicts : results of the requested tolerance tests.
    residuals : by channel, the residual of the study's fit and the sensor noise (both 1 sigma).
    noise : sensor noise that the study estimated, by channel (1 sigma); empty if unknown.
    """

    study: Path
    stored: StoredModel
    vehicle: str
    record: Record
    source: InputFile
    channels: tuple[str, ...]
    after: Simulation
    before: Simulation | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    simulated: bool = False
    verdicts: tuple[ToleranceVerdict, ...] = ()
    residuals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)


def predict_record(request: PredictionRequest) -> PredictionResult:
    """Read the model of a study and a record, and predict the record.

    Raises
    ------
    DeclarationError : the folder has no stored model, or a user's file that the study used is not
        named or has changed.
    RecordError : the record cannot be used.
    """
    tests = read_tests(request.tolerances) if request.tolerances is not None else ()
    file = read_stored_study(request.study)
    vehicle = vehicle_of_study(file, request.model)
    model = model_of_file(vehicle)
    stored = file.model(_user_effects(file, request.effects, model))
    source = opened(request.record)
    known = channel_units(vehicle.own) if vehicle.own is not None else CHANNEL_UNITS
    choices = read_channel_map(request.channels, known) if request.channels is not None else None
    reading, plan = stored.reading, _plan_of_study(stored, request.plan)
    model = model.with_noise(Noise()) if stored.made_by == DIAGNOSE else model
    decided = Decided(Hold(reading.hold), reading.weight)
    ready = prepare(
        (),
        model,
        plan,
        choices,
        [source],
        use_measured_airspeed=reading.flow,
        attitude=reading.attitude,
        decided=decided,
        part=plan.segments[0],
    )
    (record,), declared = ready.predicted, ready.model
    _refuse_without_attitude(stored, declared, record)
    refuse_unpredictable([record], declared, "")
    channels = tuple(name for name in stored.after.outputs if name in record.output_names)
    if not channels:
        remedy = (
            f"the study's outputs are {', '.join(stored.after.outputs)}; map the columns with "
            "--channels"
        )
        raise RecordError(
            "it has none of the study's outputs", where=str(source.path), remedy=remedy
        )
    predict_parts = (
        _predict_like_diagnosis if stored.made_by == DIAGNOSE else _predict_like_identification
    )
    record, before, after, cleaned = predict_parts(stored, declared, ready, trusted=plan.trusted)
    masks = [left_out(*pair) for pair in zip(ready.validation, cleaned, strict=True)]
    ready = replace(ready, look=with_outliers(ready.look, ready.validation, masks))
    notes = (*not_recorded(stored.after.outputs, [record]), *ready.notes)
    return PredictionResult(
        request.study,
        stored,
        vehicle.name,
        record,
        source.identity,
        channels,
        after,
        before,
        (*files_read_unnamed([source], None), *notes),
        (*ready.doubts, *ready.look.set_aside),
        all_simulated([source]),
        verdicts_of(tests, record, channels, after.rows) if after.figures is not None else (),
        residuals_of(request.study),
        sensor_noise_of(request.study),
    )


def _predict_like_identification(
    stored: StoredModel, declared: Model, ready: PreparedData, *, trusted: bool
) -> tuple[Record, Simulation | None, Simulation, list[Record]]:
    """Predict a record as ``identify --validate`` does.

    Returns
    -------
    The record; no simulation of the declared model; the simulation with the identified model; the
    parts of the record without their outliers.
    """
    model = with_weight(declared) if stored.weighed else declared
    system = compile_model(model.with_biases(stored.biases), stored.after.outputs)
    fits = record_fits(
        [],
        ready.validation,
        system,
        stored.after.shared,
        stored.after.settings,
        [PATH],
        trusted=trusted,
    )
    (fit,) = pooled_fits(fits, ready.parted)
    recorded = [row for row, name in enumerate(fit.outputs) if name in fit.record.output_names]
    return (
        fit.record,
        None,
        Simulation(fit.simulated[recorded], fit.figures),
        [each.record for each in fits],
    )


def _predict_like_diagnosis(
    stored: StoredModel, declared: Model, ready: PreparedData, *, trusted: bool
) -> tuple[Record, Simulation | None, Simulation, list[Record]]:
    """Predict a record as ``diagnose --validate`` does, which searches every record for outliers.

    Returns
    -------
    The record; the simulations with the declared and with the final model; the parts of the record
    without their outliers.
    """
    assert stored.before is not None
    found = predict(
        stored.before,
        stored.after,
        declared.with_biases(stored.biases),
        ready.validation,
        stored.spiked,
    )
    (whole,) = ready.parted
    rows = [[each.before for each in found.predictions], [each.after for each in found.predictions]]
    record, (before, after) = put_together(whole, ready.validation, rows)
    channels = found.predictions[0].channels
    wrong_samples = [
        {name: ~mask[row] & part[name].valid for row, name in enumerate(channels)}
        for part, mask in zip(ready.validation, found.counted, strict=True)
    ]
    parts = [
        without(part, masks) for part, masks in zip(ready.validation, wrong_samples, strict=True)
    ]
    return (
        record,
        Simulation(before, found.before),
        Simulation(after, found.after if found.finite else None),
        parts,
    )


def _user_effects(
    file: StoredStudy, effects: Path | tuple[Traceable, ...] | None, model: Model
) -> Sequence[Traceable]:
    """Return the user's effects from a file or from memory; none if ``effects`` is None.

    Raises
    ------
    DeclarationError : the study used no effects of a user's, or another file.
    """
    known = file.file("effects_file")
    if effects is None:
        return ()
    if not isinstance(effects, Path):
        return checked_effects(effects, model, "effects")
    if known is None:
        raise DeclarationError(
            "the study used no user effects", where="--effects", remedy="leave it out"
        )
    return read_effects(unchanged_file(effects, known, "--effects"), model)


def _plan_of_study(stored: StoredModel, requested: Plan) -> Plan:
    """Return the preparation of a study, with the requested part of the record."""
    reading = stored.reading
    hold = Hold(reading.hold) if reading.by_hand else None
    trusted = reading.trusted or requested.trusted
    return Plan(
        requested.segments,
        hold,
        requested.rate or reading.rate or None,
        reading.lowpass or None,
        trusted,
        requested.columns,
        requested.chosen,
    )


def _refuse_without_attitude(stored: StoredModel, declared: Model, record: Record) -> None:
    """Raise RecordError if the model needs the recorded pitch attitude and the record has none."""
    needs_attitude = stored.weighed or any(
        getattr(effect, "attitude_recorded", False) for effect in stored.after.effects
    )
    inputs = {signal.name for signal in declared.equations.inputs}
    if needs_attitude and ATTITUDE not in inputs:
        what = "it has no theta, which the study's model takes from the record"
        raise RecordError(
            what, where=record.name, remedy="give a record with theta, or make the study without it"
        )


def figures_of(simulation: Simulation) -> Mapping[str, Mapping[str, float]]:
    """Return rms error, fit in per cent, R squared and Theil's coefficient by channel; empty if the
    simulation diverged.
    """
    errors = simulation.figures
    if errors is None:
        return {}
    return {
        name: {
            "rms_error": error,
            "fit_percent": errors.fit_percent(name),
            "r2": errors.r2[name],
            "theil": errors.theil[name],
        }
        for name, error in errors.rmse.items()
    }


# ---- The figure of a prediction


def prediction_figures(found: PredictionResult) -> Iterator[Named]:
    """Yield the figures of a prediction: measured and predicted outputs, and tolerance tests.

    With a diagnosis that added effects, the outputs of the declared model are also shown. A
    simulation that diverged has no figure. A band shows the residual of sensor noise alone.
    """
    from scenarios.plots.signals import MethodOutputs, context, figure_fit

    if found.after.figures is None:
        return
    shown = [MethodOutputs("predicted", dict(zip(found.channels, found.after.rows, strict=True)))]
    if found.before is not None and found.stored.after.effects:
        shown.insert(
            0,
            MethodOutputs("as declared", dict(zip(found.channels, found.before.rows, strict=True))),
        )
    title = (
        f"{found.record.name}: {found.stored.model}, {found.stored.made_by}\nfixed parameters; "
        "only initial states and biases are fitted"
    )
    data = SIMULATED_DATA if found.simulated else MEASURED_DATA
    above = context(found.record, found.channels)
    yield (
        "prediction",
        partial(figure_fit, found.record, shown, None, title, found.noise, data, above),
    )
    yield from tolerance_figures(found.verdicts, found.record, found.channels, found.after.rows)


# ---- A prediction in lines for the terminal

TITLE = "simulation with the study's parameters held fixed; initial states and biases are fitted"


def prediction_text(found: PredictionResult, width: int = WIDTH) -> str:
    """Return the text of a prediction: record, model, warnings, and errors by channel."""
    record, stored = found.record, found.stored
    effects = [effect.name for effect in stored.after.effects]
    lines = wrapped(f"{_samples(found)}; {predicting_model(found)} ({found.study})", width)
    for warning in found.warnings:
        lines += wrapped(f"warning: {warning}", width)
    if stored.made_by == DIAGNOSE and effects and not stored.claimed:
        lines += wrapped(
            f"the study claims no effect; the prediction uses {' and '.join(effects)}, the most "
            "probable set that its search found",
            width,
        )
    lines += table_as_lines(errors_table(found), width, keys=2)
    lines += wrapped(COLUMNS_NOTE, width)
    if verdict := error_against_fit(found.after, found.residuals):
        lines += wrapped(f"verdict: {verdict}", width)
    if found.verdicts:
        lines += ["", *table_as_lines(tolerance_table(found.verdicts, record), width, keys=1)]
    for note in found.notes:
        lines += wrapped(f"note: {note}", width)
    return "\n".join(lines) + "\n"


def predicting_model(found: PredictionResult) -> str:
    """Return a phrase on the model: its name, vehicle, command that made it, and effects."""
    stored = found.stored
    effects = [effect.name for effect in stored.after.effects]
    vehicle = vehicle_with_file(found.vehicle, stored.vehicle)
    return f"{stored.model} model of {vehicle}, from {stored.made_by}" + (
        f" with {' and '.join(effects)}" if effects else ""
    )


def errors_table(found: PredictionResult) -> Table:
    """Return the errors of the prediction, after those of the declared model if the study added
    effects to it.
    """
    before = (
        _error_rows(found, found.before, "as declared")
        if found.before is not None and found.stored.after.effects
        else []
    )
    rows = [*before, *_error_rows(found, found.after, "predicted")]
    shown = rows_table(TITLE, (Column("simulation", printed=" "), *FITS), rows)
    return with_noise(shown, found.noise, found.record) if found.noise else shown


def _error_rows(found: PredictionResult, simulation: Simulation, label: str) -> list[list[Cell]]:
    errors = simulation.figures
    if errors is None:
        return [[label, *NO_FIT]]
    rows = []
    for name, error in errors.rmse.items():
        size = Quantity(error, 0.0, found.record[name].unit)
        fit = errors.fit_percent(name), errors.r2[name], errors.theil[name]
        rows.append([label, *fit_cells(name, size, *fit)])
    return rows


def _verdict(found: PredictionResult) -> tuple[str, str]:
    """Return a verdict on the tolerance tests, and its tone on the page.

    The verdict is empty if no test was requested.
    """
    if found.after.figures is None:
        return "no finite simulation", "open"
    if not found.verdicts:
        return "", "plain"
    passed, count = sum(each.passed for each in found.verdicts), len(found.verdicts)
    return f"{passed} of {count} tests passed", "good" if passed == count else "open"


# ---- The page of a prediction


def prediction_page(found: PredictionResult, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a prediction with the figures ``drawn``."""
    record, errors = found.record, found.after.figures
    verdict, tone = _verdict(found)
    fits = ""
    if errors is not None and errors.nrmse:
        worst = min(errors.nrmse, key=errors.fit_percent)
        fits = (
            f"smallest fit of {len(found.channels)} channels: {worst}, "
            f"{errors.fit_percent(worst):.1f} %"
        )
    stored = (
        ("vehicle", found.stored.vehicle),
        ("model", found.stored.own_file),
        ("effects", found.stored.effects_file),
    )
    inputs = [
        ("predicted", found.source.name, found.source.sha256),
        *((use, file.name, file.sha256) for use, file in stored if file is not None),
    ]
    return Page(
        title=f"{record.name}: predicted",
        kind=predicting_model(found),
        verdict=verdict,
        tone=tone,
        sentence=as_sentence(error_against_fit(found.after, found.residuals) or fits),
        summary=(),
        warnings=tuple(map(as_sentence, found.warnings)),
        sections=(
            *section("Measured and predicted", *figures(drawn)),
            *section("Errors", errors_table(found)),
            *(
                section("Tolerances", tolerance_table(found.verdicts, record))
                if found.verdicts
                else ()
            ),
            *section(
                "How it was made", Bullets(tuple(map(as_sentence, (_samples(found), *found.notes))))
            ),
        ),
        reproduction=reproduction(
            ["flightid", "predict", str(found.study), record.name], "", inputs
        ),
        created=now(),
    )


def _samples(found: PredictionResult) -> str:
    record = found.record
    return f"{record.name}: {extent(record)}"


# ---- The folder of a prediction: time histories, a figure, and the JSON last

MAIN = "prediction.json"
SCHEMA = "flightid/prediction/1"
DECLARED = "declared_"


def write_prediction(
    found: PredictionResult, folder: str | Path, *, figures: Formats = USUAL
) -> Path:
    """Write time histories, figures, page and ``prediction.json`` of a prediction, and return the
    folder.
    """
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / "prediction.csv", _table(found))
        drawn = draw_into(scratch, prediction_figures(found), figures)
        write_page(scratch, prediction_page(found, drawn))
        write_json(scratch / MAIN, prediction_content(found))
    return Path(folder)


def prediction_content(found: PredictionResult) -> dict[str, Any]:
    """Return the content of ``prediction.json``; errors are in SI units, of nz in g.

    Of a diagnosis, ``declared`` has the errors of the model without the added effects.
    """
    stored, record = found.stored, found.record
    files = {"vehicle": stored.vehicle, "model": stored.own_file, "effects": stored.effects_file}
    return {
        "schema": SCHEMA,
        "study": found.study.name,
        "made_by": stored.made_by,
        "model": stored.model,
        "vehicle": found.vehicle,
        "effects": [effect.name for effect in stored.after.effects],
        "claimed": list(stored.claimed),
        "record": {
            "name": record.name,
            "samples": len(record),
            "from": float(record.time[0]),
            "to": float(record.time[-1]),
        },
        "units": {name: record[name].unit for name in found.channels},
        "finite": found.after.figures is not None,
        "channels": figures_of(found.after),
        **({"declared": figures_of(found.before)} if found.before is not None else {}),
        **({"tolerances": tolerance_content(found.verdicts, record)} if found.verdicts else {}),
        "warnings": list(found.warnings),
        "notes": list(found.notes),
        "inputs": {
            "record": found.source.name,
            "record_sha256": found.source.sha256,
            **{
                key: value
                for name, file in files.items()
                if file is not None
                for key, value in ((name, file.name), (f"{name}_sha256", file.sha256))
            },
        },
        "versions": versions(),
    }


def _table(found: PredictionResult) -> str:
    """Return the CSV text of the time histories; a cell without a number is empty.

    The columns are ``time``, and for each channel ``NAME``, ``predicted_NAME`` and, of a diagnosis,
    ``declared_NAME``.
    """
    columns = {"time": found.record.time.tolist()}
    for i, name in enumerate(found.channels):
        columns[name] = found.record[name].with_gaps().tolist()
        columns[f"{PREDICTED}{name}"] = found.after.rows[i].tolist()
        if found.before is not None:
            columns[f"{DECLARED}{name}"] = found.before.rows[i].tolist()
    rows = zip(*columns.values(), strict=True)
    return csv_text(columns, ([repr(cell) if cell == cell else "" for cell in row] for row in rows))
