"""The study folder of an identification: what was read, responses, figures, and the JSON last."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ident.flying_qualities.levels import Flown, mode_levels
from scenarios.files.folders import study_folder
from scenarios.files.measured.record_file import all_simulated, identities
from scenarios.files.measured.sidecar import sidecar_path
from scenarios.files.sources import InputFile, resolved
from scenarios.files.versions import versions
from scenarios.files.writing import RESPONSE, write_json, write_record, write_responses
from scenarios.identification.assessment.content import constraints_content, fits_content, intervals_content
from scenarios.identification.from_files import Identified
from scenarios.identification.input_reading import reading_content
from scenarios.identification.report.keeping import kept_identification
from scenarios.identification.report.noise import estimated_noise
from scenarios.identification.report.page import identification_page
from scenarios.identification.result import Identification
from scenarios.kept.kept_model import write_kept
from scenarios.pages.folder import write_page
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.preparation.record_words import record_content
from scenarios.studies.comparison import estimate_content
from scenarios.terminal.flying_qualities import levels_content
from sim.errors import FlightidError

MAIN = "comparison.json"
SCHEMA = "flightid/comparison/1"


def write_identification(identified: Identified, out: Path, *, figures: Formats = USUAL) -> Path:
    """Write the study into the folder ``out``, whole or not at all; returns the folder."""
    found, measured = identified.found, identified.measured
    made = all_simulated([*identified.files, *identified.validation])
    with study_folder(out, MAIN) as scratch:
        kept = kept_identification(found, identified.plan)
        if kept is not None:
            write_kept(scratch, kept)
        for fit in found.fits[:1]:
            simulated = {name: row for name, row in zip(fit.outputs, fit.simulated, strict=True) if name in fit.record.output_names}
            write_responses(scratch / f"{RESPONSE}.csv", fit.record, simulated)
        for number, record in enumerate(measured, start=1):
            write_record(scratch, record, "record" if number == 1 else f"record_{number}", simulated=made)
        for file in (*identified.files, *identified.validation):
            _spare_inputs(scratch, out, file.path)
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.identification.figures import identification_figures
            from scenarios.plots.page.drawing import drawn_for_page

            data = SIMULATED_DATA if made else MEASURED_DATA
            drawn = drawn_for_page(identification_figures(found, measured[0], data, estimated_noise(found)), scratch, figures)
        fitted, predicted = identities(identified.files), identities(identified.validation)
        write_page(scratch, identification_page(found, identified.flown, fitted, predicted, drawn))
        write_json(scratch / MAIN, identification_content(found, fitted, identified.flown, predicted))
    return out


def _spare_inputs(scratch: Path, out: Path, path: Path) -> None:
    """Refuse to put our copy of the record in the place of the user's, unless it is the same to the byte."""
    for given in (path, sidecar_path(path)):
        ours = scratch / given.name
        if not (given.is_file() and ours.is_file() and resolved(given).parent == resolved(out)):
            continue
        if ours.read_bytes() != given.read_bytes():
            raise FlightidError("the study's record would take the place of this file", where=str(given), remedy="name another folder with --out")


def identification_content(found: Identification, files: Sequence[InputFile], flown: Flown, validation: Sequence[InputFile] = ()) -> dict[str, Any]:
    """Content of ``comparison.json`` for measured records: no ``true``, no ``published``."""
    content = estimate_content(found.estimate, found.rows, found.derived, found.fixed, found.tests)
    return {
        "schema": SCHEMA,
        "scenario": "identify",
        "model": found.vehicle.model,
        "vehicle": found.vehicle.name,
        "method": found.method,
        **({"engine": dict(found.engine)} if found.engine else {}),
        **content,
        **({"flying_qualities": levels_content(mode_levels(found.modes, flown), flown)} if found.modes is not None else {}),
        **({"biases": {row.name: {"estimate": row.estimate, "std": row.std, "unit": row.unit} for row in found.biases}} if found.biases else {}),
        **({"sensor_noise": noise} if (noise := estimated_noise(found)) else {}),
        **constraints_content(found.vehicle.constraints, found.tied, found.at_bounds),
        **intervals_content(found.intervals),
        **fits_content(found.fits),
        **({"segments": [[float(r.time[0]), float(r.time[-1])] for r in (found.record, *found.others)]} if found.others else {}),
        **({"input_reading": reading_content(reading)} if (reading := found.reading or found.decided) else {}),
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
