"""Files of an identification: its study folder, and its model as matrices, linearised about a
point.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.flying_qualities.levels import FlightPhase, mode_levels
from ident.flying_qualities.modes import LONGITUDINAL_STATES, StateSpace, level_flight, state_space
from scenarios.files.measured.columns import all_simulated, identities, sidecar_path
from scenarios.files.sources import InputFile, resolved, versions
from scenarios.files.user_models import inputs_at_rest
from scenarios.files.writing import (
    RESPONSE,
    study_folder,
    unwritable,
    write_content,
    write_json,
    write_record,
    write_responses,
)
from scenarios.identification.assessment import (
    SETTLED,
    IdentificationResult,
    RecordFit,
    reading_content,
)
from scenarios.identification.identify import Identified
from scenarios.identification.model_checks import considered_content
from scenarios.identification.report import (
    constraints_content,
    estimated_noise,
    fits_content,
    identification_page,
    intervals_content,
    stored_identification,
)
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA, axis_label, display_unit
from scenarios.preparation.recording import record_content
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import write_page
from scenarios.report.summary import levels_content
from scenarios.stored_study import write_stored_study
from scenarios.studies.comparison import estimate_content
from sim.declaration.model import Model, System
from sim.errors import DeclarationError, FlightidError
from sim.record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.plots.drawing import Named


# ---- Figures of an identification from a measured record


def identification_figures(
    found: IdentificationResult,
    measured: Record,
    data: str = MEASURED_DATA,
    sensor_noise: Mapping[str, float] = MappingProxyType({}),
) -> Iterator[Named]:
    """Return the figures of an identification: stem of each file and function that draws it.

    ``measured``: recorded channels. ``data``: name of the samples. ``sensor_noise``: standard
    deviation of outputs whose residual is larger; bands about residuals use it.
    """
    from scenarios.plots.estimates import (
        figure_correlation,
        figure_innovations,
        figure_parameter_histories,
        figure_poles,
    )
    from scenarios.plots.signals import context, figure_fit, figure_record, response_of, units_of

    estimate, title = found.estimate, f"{found.record.name}: {found.vehicle.model}, {found.method}"
    response = response_of(estimate)
    above = context(found.record, estimate.output_names)
    noise = dict(zip(estimate.output_names, estimate.noise_std.tolist(), strict=True))
    sensors = {**noise, **sensor_noise}
    yield "fit", partial(figure_fit, found.record, [response], None, title, sensors, data, above)
    yield "record", partial(figure_record, measured, title, data)
    yield from other_records(found, sensors, data)
    if found.band is not None and found.fits[0].figures is not None:
        yield "spectra", partial(figure_spectra, found.fits[0], noise, found.band, title, data)
    if estimate.history is not None:
        followed = [
            (name, unit)
            for name, unit in zip(estimate.names, estimate.units, strict=True)
            if name in estimate.history.names
        ]
        names, kinds = zip(*followed, strict=True)  # a delay that a bank found has no history
        yield (
            "parameters",
            partial(figure_parameter_histories, estimate.history, names, kinds, title=title),
        )
        units = units_of(found.record, estimate.output_names)
        yield (
            "innovations",
            partial(figure_innovations, estimate.history, estimate.output_names, units, title),
        )
    if (poles := poles_of(found)) is not None:
        yield "poles", partial(figure_poles, *poles, title)
    if len(estimate.names) > 1:
        yield (
            "correlation",
            partial(figure_correlation, estimate.names, estimate.correlation, title),
        )


POLE_DRAWS = 60  # draws of the parameters, for the poles' scatter


def poles_of(found: IdentificationResult) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the poles ``(n,)`` of the estimate, 1/s, and ``(POLE_DRAWS, n)`` at samples from its
    covariance; None if the model is not linearised about a steady motion.
    """
    system, estimate = found.system, found.estimate
    if system is None or "altitude" in system.state_names or estimate.outcome not in SETTLED:
        return None
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(
        estimate.values, estimate.covariance, POLE_DRAWS, check_valid="ignore", method="eigh"
    )
    try:
        rows = [
            linearised(
                system,
                dict(zip(estimate.names, values.tolist(), strict=True)),
                found.record,
                found.vehicle.own,
            ).eigenvalues
            for values in (estimate.values, *draws)
        ]
    except FlightidError:
        return None
    poles = np.array(rows)
    return (poles[0], poles[1:]) if poles.size and np.all(np.isfinite(poles)) else None


def other_records(
    found: IdentificationResult, noise: Mapping[str, float], data: str = MEASURED_DATA
) -> Iterator[Named]:
    """Return the simulation of every record but the first: ``fit_2``, ..., and ``held_out``,
    ``held_out_2``, ... of those that were not fitted.
    """
    from scenarios.plots.signals import MethodOutputs, context, figure_fit

    count = {True: 0, False: 0}
    for each in found.fits:
        count[each.held_out] += 1
        number = count[each.held_out]
        if each.figures is None or (number == 1 and not each.held_out):
            continue
        word = "held out, only initial states and biases are its own" if each.held_out else "fitted"
        name = f"{'held_out' if each.held_out else 'fit'}{f'_{number}' if number > 1 else ''}"
        response = MethodOutputs(
            "free simulation", dict(zip(each.outputs, each.simulated, strict=True))
        )
        title = f"{each.record.name}: {found.vehicle.model}, {found.method}\n{word}"
        above = context(each.record, each.outputs)
        yield name, partial(figure_fit, each.record, [response], None, title, noise, data, above)


def figure_spectra(
    each: RecordFit,
    noise: Mapping[str, float],
    band: tuple[float, float],
    title: str = "",
    data: str = MEASURED_DATA,
) -> Figure:
    """Plot amplitudes of recorded and simulated outputs and of their difference at the harmonics of
    the record; the fitted band is shaded.

    Transforms are divided by the root of the number of samples, so that white noise has its
    standard deviation at every frequency. Angles in degrees.
    """
    from scenarios.plots.style import (
        LABEL_SIZE,
        LIGHT,
        MEASURED,
        TRUE,
        finish,
        make_sheet,
        method_style,
        y_label,
    )

    record = each.record
    shown = [
        channel
        for channel in record.outputs
        if channel.name in each.outputs and np.any(channel.valid)
    ]
    sheet = make_sheet([1.3] * len(shown), row_gap=0.18)
    count = len(record)
    frequency = (
        np.arange(1, (count + 1) // 2) * (count - 1) / count / (record.time[-1] - record.time[0])
    )
    for channel, panel in zip(shown, sheet.panels, strict=True):
        unit = display_unit(channel.unit)
        # gaps as the fit bridges them
        bridged = np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])
        rows = bridged, each.simulated[each.outputs.index(channel.name)]
        measured, simulated = (
            unit.factor * np.fft.rfft(row)[1 : len(frequency) + 1] / np.sqrt(count) for row in rows
        )
        panel.axvspan(*band, color=LIGHT, alpha=0.5, linewidth=0, label="fitted")
        panel.plot(frequency, np.abs(measured), label=data, **{**MEASURED, "markersize": 5.0})
        panel.plot(
            frequency, np.abs(simulated), label="free simulation", **method_style(0, alone=True)
        )
        panel.plot(
            frequency,
            np.abs(measured - simulated),
            label="their difference",
            **method_style(1, alone=True),
        )
        if channel.name in noise:
            panel.axhline(unit.factor * noise[channel.name], label="noise level of the fit", **TRUE)
        panel.set_xscale("log")
        panel.set_yscale("log")
        y_label(panel, axis_label(channel.name, unit))
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.16)


# ---- The study folder of an identification

MAIN = "comparison.json"
SCHEMA = "flightid/comparison/1"


def write_identification(identified: Identified, out: Path, *, figures: Formats = USUAL) -> Path:
    """Write the study into the folder ``out``, completely or not at all; return the folder."""
    found, measured = identified.found, identified.measured
    made = all_simulated([*identified.files, *identified.validation])
    with study_folder(out, MAIN) as scratch:
        stored = stored_identification(found, identified.plan)
        if stored is not None:
            write_stored_study(scratch, stored)
        for fit in found.fits[:1]:
            simulated = {
                name: row
                for name, row in zip(fit.outputs, fit.simulated, strict=True)
                if name in fit.record.output_names
            }
            write_responses(scratch / f"{RESPONSE}.csv", fit.record, simulated)
        for number, record in enumerate(measured, start=1):
            write_record(
                scratch, record, "record" if number == 1 else f"record_{number}", simulated=made
            )
        for file in (*identified.files, *identified.validation):
            _spare_inputs(scratch, out, file.path)
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import draw_for_page

            data = SIMULATED_DATA if made else MEASURED_DATA
            drawn = draw_for_page(
                identification_figures(found, measured[0], data, estimated_noise(found)),
                scratch,
                figures,
            )
        fitted, predicted = identities(identified.files), identities(identified.validation)
        write_page(scratch, identification_page(found, identified.flown, fitted, predicted, drawn))
        write_json(
            scratch / MAIN, identification_content(found, fitted, identified.flown, predicted)
        )
    return out


def _spare_inputs(scratch: Path, out: Path, path: Path) -> None:
    """Refuse to overwrite the user's record by our copy, unless both are identical."""
    for given in (path, sidecar_path(path)):
        ours = scratch / given.name
        if not (given.is_file() and ours.is_file() and resolved(given).parent == resolved(out)):
            continue
        if ours.read_bytes() != given.read_bytes():
            raise FlightidError(
                "the study's record would take the place of this file",
                where=str(given),
                remedy="name another folder with --out",
            )


def identification_content(
    found: IdentificationResult,
    files: Sequence[InputFile],
    flown: FlightPhase,
    validation: Sequence[InputFile] = (),
) -> dict[str, Any]:
    """Return the content of ``comparison.json`` for measured records, without ``true`` and
    ``published``.
    """
    content = estimate_content(found.estimate, found.rows, found.derived, found.fixed, found.tests)
    return {
        "schema": SCHEMA,
        "scenario": "identify",
        "model": found.vehicle.model,
        "vehicle": found.vehicle.name,
        "method": found.method,
        **({"engine": dict(found.engine)} if found.engine else {}),
        **content,
        **(
            {"flying_qualities": levels_content(mode_levels(found.modes, flown), flown)}
            if found.modes is not None
            else {}
        ),
        **(
            {
                "biases": {
                    row.name: {"estimate": row.estimate, "std": row.std, "unit": row.unit}
                    for row in found.biases
                }
            }
            if found.biases
            else {}
        ),
        **({"sensor_noise": noise} if (noise := estimated_noise(found)) else {}),
        **constraints_content(found.vehicle.constraints, found.tied, found.at_bounds),
        **intervals_content(found.intervals),
        **considered_content(found.considered),
        **fits_content(found.fits),
        **(
            {
                "segments": [
                    [float(r.time[0]), float(r.time[-1])] for r in (found.record, *found.others)
                ]
            }
            if found.others
            else {}
        ),
        **(
            {"input_reading": reading_content(reading)}
            if (reading := found.reading or found.decided)
            else {}
        ),
        "warnings": [
            *found.doubts,
            *found.cautions,
            *([found.reading.sentence] if found.reading else []),
            *found.look.set_aside,
        ],
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
    return (
        {
            "validation": [file.name for file in files],
            "validation_sha256": [file.sha256 for file in files],
        }
        if files
        else {}
    )


def _model_file(found: IdentificationResult) -> dict[str, str]:
    file = found.vehicle.own_file
    return {"model": file.name, "model_sha256": file.sha256} if file is not None else {}


# ---- Identified models as matrices, linearised about a point, and their files

STATE_SPACE_SCHEMA = "flightid/state-space/1"
VELOCITY_SAMPLES = 11  # samples whose slope is the velocity of a falling body


def state_space_of(found: IdentificationResult) -> StateSpace:
    """Return the identified model as ``linearised``."""
    assert found.system is not None
    return linearised(found.system, found.estimate.as_dict(), found.record, found.vehicle.own)


def linearised(
    system: System, values: Mapping[str, float], record: Record, own: Model | None = None
) -> StateSpace:
    """Return a model linearised about a point of reference.

    The point is level flight for equations of totals, rest for perturbations, the middle of the
    record for a falling body, and declared by a user's ``own`` model. Raises DeclarationError if
    there is none.
    """
    names = set(system.state_names)
    if names.issuperset(LONGITUDINAL_STATES):
        p = system.parameters.with_values(
            {name: value for name, value in values.items() if name in system.parameters}
        ).values()
        level = level_flight(system, p)
        if level is None:
            what = "the identified model has no level flight at its reference airspeed"
            raise DeclarationError(
                what, where="--state-space", remedy="fit a record that tells elevator and lift"
            )
        return state_space(system, values, *level)
    if own is not None:
        return state_space(system, values, own.initial.values().tolist(), inputs_at_rest(own))
    if "altitude" in names:
        return state_space(system, values, [_middle(record)[name] for name in system.state_names])
    return state_space(system, values)


def _middle(record: Record) -> dict[str, float]:
    """Return the altitude and velocity of a falling body in the middle of its record, by a straight
    line through its neighbours.
    """
    channel = record["altitude"]
    t, h = record.time[channel.valid], channel.values[channel.valid]
    first = max(0, (len(t) - VELOCITY_SAMPLES) // 2)
    near = slice(first, first + VELOCITY_SAMPLES)
    at = float(t[near].mean())
    velocity, altitude = np.polyfit(t[near] - at, h[near], 1)
    return {"altitude": float(altitude), "velocity": float(velocity)}


def state_space_content(space: StateSpace) -> dict[str, Any]:
    """Return the content of the JSON file: matrices as rows, signals with units, the point, roots
    of A.
    """
    roots = space.eigenvalues
    return {
        "schema": STATE_SPACE_SCHEMA,
        **{name: getattr(space, name).tolist() for name in "ABCD"},
        **{
            kind: [{"name": s.name, "unit": s.unit} for s in getattr(space, kind)]
            for kind in ("states", "inputs", "outputs")
        },
        "about": {name: getattr(space, name).tolist() for name in ("x0", "u0", "y0", "rates")},
        "delays": dict(space.delays),
        "left_out": list(space.left_out),
        "eigenvalues": [[float(root.real), float(root.imag)] for root in roots],
    }


def _json(space: StateSpace) -> bytes:
    return (json.dumps(state_space_content(space), indent=2, allow_nan=False) + "\n").encode()


def _arrays(space: StateSpace) -> dict[str, Any]:
    """Return the matrices, names and units as arrays; rows of names as the columns and rows of the
    matrices.
    """
    signals = {
        f"{kind}_{what}": np.array([getattr(s, what[:-1]) for s in getattr(space, kind)], dtype=str)
        for kind in ("states", "inputs", "outputs")
        for what in ("names", "units")
    }
    delays = np.array([space.delays.get(s.name, 0.0) for s in space.inputs])
    return {
        **{name: getattr(space, name) for name in (*"ABCD", "x0", "u0", "y0", "rates")},
        **signals,
        "delays": delays,
    }


def _npz(space: StateSpace) -> bytes:
    to = io.BytesIO()
    np.savez(to, **_arrays(space))
    return to.getvalue()


def _mat(space: StateSpace) -> bytes:
    from scipy.io import savemat

    cells = {
        name: value.astype(object) if value.dtype.kind == "U" else value
        for name, value in _arrays(space).items()
    }
    to = io.BytesIO()
    savemat(to, cells, oned_as="column")
    return to.getvalue()


FORMATS: Mapping[str, Callable[[StateSpace], bytes]] = MappingProxyType(
    {".json": _json, ".mat": _mat, ".npz": _npz}
)


def refuse_place(path: Path, kept: Iterable[Path] = ()) -> None:
    """Raise DeclarationError for an ending that no format has, for a folder, and for one of the
    files ``kept`` or what stands beside a record.
    """
    where = f"--state-space, {path}"
    if path.suffix.lower() not in FORMATS:
        what = f"{path.suffix or 'no'} ending"
        raise DeclarationError(
            what, where=where, remedy=f"name a file that ends in {', '.join(FORMATS)}"
        )
    if path.is_dir():
        raise DeclarationError("this is a folder", where=where, remedy="name a file")
    if resolved(path) in {
        resolved(each) for given in kept for each in (given, sidecar_path(given))
    }:
        raise DeclarationError(
            "the matrices would take the place of a record or of the study",
            where=where,
            remedy="name another file",
        )


def write_state_space(space: StateSpace, path: Path) -> None:
    """Write the matrices in the format of the file's ending; a JSON file is text, the others are
    arrays by name.
    """
    refuse_place(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_content(path, FORMATS[path.suffix.lower()](space))
    except OSError as error:
        raise unwritable(path, error, "name a file that you may write") from None
