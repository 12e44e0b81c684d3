"""`flightid identify`: a measured record to parameters, printed and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.flying_qualities.mode_levels import Flown, mode_levels
from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.files.measured.record_file import RecordFile, identities
from scenarios.files.own_models import channel_units
from scenarios.files.sources import InputFile
from scenarios.files.versions import versions
from scenarios.identification.assessment.content import constraints_content, fits_content, intervals_content
from scenarios.identification.assessment.intervals import SETTLED
from scenarios.identification.assessment.text import bound_lines, fit_lines, interval_lines
from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.identify import identify
from scenarios.identification.input_reading import opposite, other_reading, reading_content, reading_rows
from scenarios.identification.methods import FILTERS, METHODS, uses_attitude
from scenarios.identification.result import PLAIN, Identification, Options
from scenarios.plots.formats import Formats
from scenarios.plots.page.named import Drawn
from scenarios.preparation.plausibility import refuse_strangers
from scenarios.preparation.record_words import record_content, record_lines
from scenarios.preparation.request import Request, column_choices, flown_of
from scenarios.studies.comparison import estimate_content
from scenarios.terminal.flying_qualities import levels_content, levels_line
from sim.errors import DeclarationError, FlightidError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from scenarios.preparation.plan import Plan
    from scenarios.preparation.reading import Prepared

SCHEMA = "flightid/comparison/1"
ALL = "all"  # of --profile: every parameter


def options_of(profile: Sequence[str] | None, band: tuple[float, float] | None, engine: str | None = None) -> Options:
    """What a command line asks besides the method."""
    names = None if profile is None else () if ALL in profile else tuple(dict.fromkeys(profile))
    return Options(names, band, engine)


def identify_records(
    request: Request, method: str, out: Path | None, figures: Formats, options: Options = PLAIN, matrices: Path | None = None
) -> None:
    """Read, identify, write the study and the linearised model's ``matrices``, print."""
    from scenarios.files.measured.record_file import read_record_files, refuse_twice
    from scenarios.files.vehicles import read_vehicle, refuse_unknown_model, vehicle_beside
    from scenarios.identification.state_space import refuse_place, state_space_of, write_state_space
    from scenarios.preparation.plausibility import refuse_still, refuse_unpredictable
    from scenarios.preparation.reading import prepare
    from scenarios.preparation.vehicle_model import model_of_file

    refuse_unknown_model(request.model, "--model")
    if method not in METHODS:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=f"use one of {', '.join(METHODS)}")
    if matrices is not None:
        ours = [out / "comparison.json", out / "record.csv"] if out is not None else []
        refuse_place(matrices, [*request.records, *request.validate, *ours])
    refuse_twice([*request.records, *request.validate], "name each record once, for the fit or for --validate")
    vehicle = read_vehicle(request.vehicle or vehicle_beside(request.records[0]), request.model)
    flown = flown_of(request, vehicle)
    choices = column_choices(request, channel_units(vehicle.own) if vehicle.own is not None else CHANNEL_UNITS)
    files, validation = read_record_files(request.records), read_record_files(request.validate)
    # The filter of the low-order system has equations of its own, at one speed, and finds the trim itself.
    own = request.model == "loes" and method == "ekf"

    def identified(plan: Plan, asked: Options) -> tuple[Prepared, Identification]:
        flow, attitude = not own and method != FREQUENCY, uses_attitude(vehicle, method)
        ready = prepare(files, model_of_file(vehicle), plan, choices, validation, flow=flow, attitude=attitude)
        refuse_strangers(ready.fitted, ready.validation)
        refuse_still(ready.fitted, ready.model)
        refuse_unpredictable(ready.validation, ready.model)
        first, *others = ready.measured if own else ready.fitted
        found = identify(first, vehicle, method, others, ready.model, ready.validation, asked)
        return ready, replace(found, notes=(*ready.notes, *found.notes), doubts=ready.doubts, look=ready.look)

    ready, found = identified(request.plan, options)
    if method not in FILTERS and found.record.inputs and request.plan.hold is None and not any(file.sidecar.says_hold for file in files):
        found = _read_otherwise(found, lambda hold: identified(replace(request.plan, hold=hold), replace(options, profile=None))[1])
    space = state_space_of(found) if matrices is not None else None
    if out is not None:
        _write(found, flown, ready.measured, (files, validation), out, figures)
    _print(found, flown)
    if matrices is not None and space is not None:
        write_state_space(space, matrices)
        print(f"matrices written to {matrices}")
    if out is not None:
        print(f"written to {out}")


def _read_otherwise(found: Identification, again: Callable[[Hold], Identification]) -> Identification:
    """The identification with what the other reading of its inputs changes, where it says anything."""
    used = found.record.hold
    other = again(opposite(used))
    if any(each.estimate.outcome not in SETTLED for each in (found, other)):
        return found
    gain = 2.0 * (other.estimate.log_likelihood - found.estimate.log_likelihood)
    return replace(found, reading=other_reading(used, found.rows, other.rows, gain))


def identification_content(found: Identification, files: Sequence[InputFile], flown: Flown, validation: Sequence[InputFile] = ()) -> dict[str, Any]:
    """Content of ``comparison.json`` for measured records: no ``true``, no ``published``."""
    content = estimate_content(found.estimate, found.rows, found.derived, found.fixed, found.tests)
    return {
        "schema": SCHEMA,
        "scenario": "identify",
        "model": found.vehicle.model,
        "vehicle": found.vehicle.name,
        "method": found.method,
        **content,
        **({"flying_qualities": levels_content(mode_levels(found.modes, flown), flown)} if found.modes is not None else {}),
        **({"biases": {row.name: {"estimate": row.estimate, "std": row.std, "unit": row.unit} for row in found.biases}} if found.biases else {}),
        **constraints_content(found.vehicle.constraints, found.tied, found.at_bounds),
        **intervals_content(found.intervals),
        **fits_content(found.fits),
        **({"segments": [[float(r.time[0]), float(r.time[-1])] for r in (found.record, *found.others)]} if found.others else {}),
        **({"input_reading": reading_content(found.reading)} if found.reading else {}),
        "warnings": [*found.doubts, *found.cautions, *([found.reading.sentence] if found.reading else []), *found.look.set_aside],
        "notes": list(found.notes),
        "record": record_content(found.look),
        "inputs": {
            "records": [file.name for file in files],
            "sha256": [file.sha256 for file in files],
            **_validated(validation),
            **_model_file(found),
        },
        "versions": versions(),
    }


def _validated(files: Sequence[InputFile]) -> dict[str, list[str]]:
    """Names and hashes of the files that were only predicted."""
    return {"validation": [file.name for file in files], "validation_sha256": [file.sha256 for file in files]} if files else {}


def _model_file(found: Identification) -> dict[str, str]:
    """Name and hash of a user's own model file."""
    file = found.vehicle.own_file
    return {"model": file.name, "model_sha256": file.sha256} if file is not None else {}


def _write(
    found: Identification,
    flown: Flown,
    measured: Sequence[Record],
    files: tuple[Sequence[RecordFile], Sequence[RecordFile]],
    out: Path,
    figures: Formats,
) -> None:
    """The study; ``files`` are those of the fit and those that were predicted."""
    from scenarios.files.folders import study_folder
    from scenarios.files.writing import RESPONSE, write_json, write_record, write_responses
    from scenarios.identification.page import identification_page
    from scenarios.pages.folder import write_page

    with study_folder(out, "comparison.json") as scratch:
        for fit in found.fits[:1]:
            simulated = {name: row for name, row in zip(fit.outputs, fit.simulated, strict=True) if name in fit.record.output_names}
            write_responses(scratch / f"{RESPONSE}.csv", fit.record, simulated)
        for number, record in enumerate(measured, start=1):
            write_record(scratch, record, "record" if number == 1 else f"record_{number}")
        for file in (*files[0], *files[1]):
            _spare_inputs(scratch, out, file.path)
        drawn: tuple[Drawn, ...] = ()
        fitted, predicted = identities(files[0]), identities(files[1])
        if figures:
            from scenarios.identification.figures import identification_figures
            from scenarios.plots.page.drawing import drawn_for_page

            drawn = drawn_for_page(identification_figures(found, measured[0]), scratch, figures)
        write_page(scratch, identification_page(found, flown, fitted, predicted, drawn))
        write_json(scratch / "comparison.json", identification_content(found, fitted, flown, predicted))


def _spare_inputs(scratch: Path, out: Path, path: Path) -> None:
    """Refuse to put our copy of the record in the place of the user's, unless it is the same to the byte."""
    from scenarios.files.measured.sidecar import sidecar_path

    for given in (path, sidecar_path(path)):
        ours = scratch / given.name
        if not (given.is_file() and ours.is_file() and given.resolve().parent == out.resolve()):
            continue
        if ours.read_bytes() != given.read_bytes():
            raise FlightidError("the study's record would take the place of this file", where=str(given), remedy="name another folder with --out")


def _print(found: Identification, flown: Flown) -> None:
    from ident.tracing.diagnosis import Quantity
    from scenarios.terminal.numbers import console, derived_line, number, test_line
    from scenarios.terminal.quantities import determined, displayed
    from scenarios.terminal.tables import columns_of, print_table

    estimate, terminal = found.estimate, console()
    for record in (found.record, *found.others):
        told = f"; {found.vehicle.model} model, {found.method}: {estimate.outcome.value}" if record is (found.record, *found.others)[-1] else ""
        terminal.print(f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s{told}")
    for doubt in found.doubts:
        terminal.print(f"warning: {doubt}", highlight=False)
    for caution in found.cautions:
        terminal.print(f"caution: {caution}", highlight=False)
    for line in record_lines(found.look):
        terminal.print(line, highlight=False)
    for line in bound_lines(found.at_bounds, found.tied):
        terminal.print(line, highlight=False)
    rows: list[tuple[str, ...]] = []
    starts = {**found.vehicle.derivatives, **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()}}
    for row in (*found.rows, *found.biases):
        begun = f"{starts[row.name]:.5g}" if row.name in starts else "-"
        if not determined(row.estimate, row.std):
            rows.append((row.name, row.unit, "not determined", "-", "-", begun))
            continue
        share = f"{100.0 * row.std / abs(row.estimate):.2g}" if row.estimate else "-"
        rows.append((row.name, row.unit, number(row.estimate, row.std), number(row.std, row.std), share, begun))
    print_table(terminal, "", columns_of(("parameter", "unit", "estimate", "+- sigma", "sigma %", "start"), rows, left=2))
    for line in interval_lines(found.intervals, {row.name: row.unit for row in found.rows}):
        terminal.print(line, highlight=False)
    if found.reading:
        terminal.print(f"caution: {found.reading.sentence}", highlight=False)
        for line in reading_rows(found.reading):
            terminal.print(line, highlight=False)
    units = {channel.name: channel.unit for record in (found.record, *found.others) for channel in record.outputs}
    levels = zip(estimate.output_names, estimate.noise_std, strict=True)
    shown = [(name, displayed(Quantity(float(std), 0.0, units.get(name, "")))) for name, std in levels]
    noise = ", ".join(f"{name} {value:.3g}{f' {unit}' if unit != '1' else ''}" for name, (value, _, unit) in shown)
    terminal.print(f"residual (1 sigma): {noise}", highlight=False)
    for line in fit_lines(found.fits) if len(found.fits) > 1 else ():
        terminal.print(line, highlight=False)
    reached = levels_line(mode_levels(found.modes, flown), flown, found.tests) if found.modes is not None else ""
    for line in (derived_line(found.derived), reached, test_line(found.tests), *(f"note: {note}" for note in found.notes)):
        if line:
            terminal.print(line, highlight=False)
