"""`flightid identify`: a measured record to parameters, printed and written."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from scenarios.comparing import estimate_content, versions
from scenarios.identifying import METHODS, Identification, identify
from sim.errors import DeclarationError, FlightidError

SCHEMA = "flightid/comparison/1"
MODELS = ("ballistic", "rigid", "flexible", "loes")


def identify_record(
    path: Path,
    model: str,
    vehicle_path: Path,
    channels: Path | None,
    start: float | None,
    stop: float | None,
    method: str,
    out: Path | None,
    figures: bool,
) -> None:
    """Read, identify, write the study, print."""
    from scenarios.files.channels import read_channel_map
    from scenarios.files.records import read_record
    from scenarios.files.vehicles import read_vehicle
    from scenarios.vehicle_models import model_of_file

    if model not in MODELS:
        raise DeclarationError(f"there is no model {model!r}", where="--model", remedy=f"use one of {', '.join(MODELS)}")
    if method not in METHODS:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=f"use one of {', '.join(METHODS)}")
    vehicle = read_vehicle(vehicle_path, model)
    equations = model_of_file(vehicle).equations
    record = read_record(
        path,
        [signal.name for signal in equations.inputs],
        [signal.name for signal in equations.outputs],
        read_channel_map(channels) if channels is not None else None,
        start,
        stop,
    )
    found = identify(record, vehicle, method)
    if out is not None:
        _write(found, path, out, figures)
    _print(found)
    if out is not None:
        print(f"written to {out}")


def identification_content(found: Identification, path: Path) -> dict[str, Any]:
    """Content of ``comparison.json`` for a measured record: no ``true``, no ``published``."""
    content = estimate_content(found.estimate, found.rows, found.derived, found.fixed, found.tests)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return {
        "schema": SCHEMA,
        "scenario": "identify",
        "model": found.vehicle.model,
        "vehicle": found.vehicle.name,
        "method": found.method,
        **content,
        **({"biases": {row.name: {"estimate": row.estimate, "std": row.std, "unit": row.unit} for row in found.biases}} if found.biases else {}),
        "inputs": {"records": [path.name], "sha256": [digest]},
        "versions": versions(),
    }


def _write(found: Identification, path: Path, out: Path, figures: bool) -> None:
    from scenarios.files.folders import study_folder
    from scenarios.files.writing import write_json, write_record

    with study_folder(out, "comparison.json") as scratch:
        write_record(scratch, found.record)
        _spare_inputs(scratch, out, path)
        if figures:
            from scenarios.study_figures import draw_identification

            draw_identification(found, scratch)
        write_json(scratch / "comparison.json", identification_content(found, path))


def _spare_inputs(scratch: Path, out: Path, path: Path) -> None:
    """Refuse to put our copy of the record in the place of the user's, unless it is the same to the byte."""
    from scenarios.files.sidecar import sidecar_path

    for given in (path, sidecar_path(path)):
        ours = scratch / given.name
        if not (given.is_file() and ours.is_file() and given.resolve().parent == out.resolve()):
            continue
        if ours.read_bytes() != given.read_bytes():
            raise FlightidError("the study's record would take the place of this file", where=str(given), remedy="name another folder with --out")


def _print(found: Identification) -> None:
    from rich.table import Table

    from scenarios.printing import console, derived_line, number, test_line

    estimate, terminal = found.estimate, console()
    span = f"{found.record.time[0]:g} to {found.record.time[-1]:g} s"
    terminal.print(f"{found.record.name}: {len(found.record)} samples, {span}; {found.vehicle.model} model, {found.method}: {estimate.outcome.value}")
    table = Table()
    for heading in ("parameter", "unit", "estimate", "+- sigma", "sigma %", "start"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right", no_wrap=True)
    starts = {**found.vehicle.derivatives, **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()}}
    for row in (*found.rows, *found.biases):
        share = f"{100.0 * row.std / abs(row.estimate):.2g}" if row.estimate else "-"
        begun = f"{starts[row.name]:.5g}" if row.name in starts else "-"
        table.add_row(row.name, row.unit, number(row.estimate, row.std), number(row.std, row.std), share, begun)
    terminal.print(table)
    noise = ", ".join(f"{name} {std:.3g}" for name, std in zip(estimate.output_names, estimate.noise_std, strict=True))
    terminal.print(f"residual (1 sigma): {noise}", highlight=False)
    for line in (derived_line(found.derived), test_line(found.tests)):
        if line:
            terminal.print(line, highlight=False)
