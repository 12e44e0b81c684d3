"""The page of an identification from measured records."""

from __future__ import annotations

import os
from collections.abc import Sequence

from ident.estimate import Outcome
from ident.flying_qualities.levels import Flown, mode_levels
from scenarios.files.sources import InputFile
from scenarios.identification.assessment.text import FITS, INTERVALS, PROFILED, SIMULATED, bound_lines, fit_rows, interval_rows, interval_sentences
from scenarios.identification.input_reading import reading_rows
from scenarios.identification.report.noise import noise_phrase
from scenarios.identification.report.text import identification_summary
from scenarios.identification.result import Identification
from scenarios.pages.folder import figures
from scenarios.pages.model import Block, Bullets, Page, Prose, section
from scenarios.pages.printed import columns_table, rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.tables import derived_table, estimates_table, fixed_table, levels_of_noise, tests_table
from scenarios.pages.wording import capital, sentence, summary_sentences
from scenarios.plots.page.named import Drawn
from scenarios.preparation.record_words import record_table
from scenarios.terminal.flying_qualities import levels_line

SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


def identification_page(
    found: Identification, flown: Flown, files: Sequence[InputFile], validation: Sequence[InputFile] = (), drawn: Sequence[Drawn] = ()
) -> Page:
    """The page of an identification: ``files`` were fitted, those of ``validation`` predicted."""
    estimate, records = found.estimate, (found.record, *found.others)
    settled = estimate.outcome in SETTLED
    white = all(test.passed for test in found.tests)
    inputs = [("fitted", file.name, file.sha256) for file in files] + [("predicted", file.name, file.sha256) for file in validation]
    inputs += [(use, file.name, file.sha256) for use, file in (("vehicle", found.vehicle.identity), ("model", found.vehicle.own_file)) if file]
    samples = f"{sum(map(len, records))} samples of {len(records)} records" if len(records) > 1 else f"{len(found.record)} samples"
    reading = (found.reading.sentence,) if found.reading else ()
    hint = estimate.outcome.hint
    return Page(
        title=f"{capital(found.vehicle.name)}: {_model(found)} model",
        kind=f"Identification from {', '.join(dict.fromkeys(record.name for record in records))}, {found.method}",
        verdict=estimate.outcome.value.partition(":")[0].partition(",")[0],
        tone="open" if not settled else "good" if white and not found.cautions else "fair",
        sentence=sentence(f"{len(found.rows)} parameters from {samples}" + (f". {capital(hint)}" if hint else "")),
        summary=summary_sentences(identification_summary(found)),
        warnings=tuple(map(sentence, (*found.doubts, *found.cautions, *reading))),
        sections=(
            *section("What was found", *_found(found, flown)),
            *section("Prediction", rows_table(capital(SIMULATED), FITS, fit_rows(found.fits))),
            *section("Figures", *figures(drawn)),
            *section("Residuals and noise", *_evidence(found)),
            *section("The record as it was recorded", record_table(found.look)),
            *section("How it was made", *_made(found)),
        ),
        reproduction=reproduction(_command(found, files), "", inputs),
        created=now(),
    )


def _found(found: Identification, flown: Flown) -> list[Block]:
    starts = {**found.vehicle.derivatives, **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()}}
    blocks: list[Block] = [estimates_table("Parameters", found.rows, starts)]
    blocks += [estimates_table("Biases of the sensors", found.biases)] if found.biases else []
    blocks += [derived_table("What follows from them", found.derived)] if found.derived else []
    levels = levels_line(mode_levels(found.modes, flown), flown, found.tests) if found.modes is not None else ""
    blocks += [Prose(sentence(line)) for line in (*bound_lines(found.at_bounds, found.tied), levels) if line]
    if found.intervals:
        units = {row.name: row.unit for row in found.rows}
        blocks += [rows_table(capital(PROFILED), INTERVALS, interval_rows(found.intervals, units))]
        blocks += [Prose(sentence(line)) for line in interval_sentences(found.intervals)]
    if found.reading:
        blocks += [columns_table("If the inputs were read otherwise between samples", reading_rows(found.reading))]
    return blocks


def _evidence(found: Identification) -> list[Block]:
    estimate = found.estimate
    units = {channel.name: channel.unit for record in (found.record, *found.others) for channel in record.outputs}
    noise = {name: (float(std), units.get(name, "1")) for name, std in zip(estimate.output_names, estimate.noise_std, strict=True)}
    blocks: list[Block] = [tests_table("Residual tests", found.tests)] if found.tests else []
    phrase = noise_phrase(found)
    return [*blocks, levels_of_noise("Residual, one sigma", noise), *([Prose(sentence(phrase))] if phrase else [])]


def _made(found: Identification) -> list[Block]:
    records = (found.record, *found.others)
    parts = tuple(f"{r.name}: {len(r)} samples, {r.time[0]:g} to {r.time[-1]:g} s" for r in records)
    notes = tuple(sentence(note) for note in found.notes)
    blocks: list[Block] = [Bullets(parts), Bullets(notes)]
    blocks += [Prose(sentence(f"engine: {found.engine['sentence']}"))] if found.engine else []
    return [*blocks, *([fixed_table("What was held", found.fixed)] if found.fixed else [])]


def _model(found: Identification) -> str:
    return found.vehicle.own_file.name if found.vehicle.own_file is not None else found.vehicle.model


def _command(found: Identification, files: Sequence[InputFile]) -> list[str]:
    """What would be typed for this, as far as the result tells."""
    vehicle = found.vehicle.identity
    given = ["--vehicle", os.fspath(vehicle.name)] if vehicle is not None else []
    return ["flightid", "identify", *(file.name for file in files), "--model", _model(found), *given, "--method", found.method]
