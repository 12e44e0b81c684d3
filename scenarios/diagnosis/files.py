"""The study folder of a diagnosis: ``diagnosis.json``, predictions, residuals, evidence, figures
with captions, and the page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Claim,
    Diagnosis,
    FittedRecord,
    Prediction,
    Quantity,
    Verdict,
)
from scenarios.diagnosis import tables, text
from scenarios.diagnosis.diagnose import Tracing, stored_diagnosis
from scenarios.diagnosis.evidence import evidence_sentences
from scenarios.diagnosis.opening import effort_sentence
from scenarios.diagnosis.tables import kinematics_lines, levels_table, levels_title
from scenarios.diagnosis.text import DECIDES, LARGEST, bounded, diagnosis_content
from scenarios.diagnosis.wording import (
    DECLARED,
    as_declared,
    declared_alone,
    is_unexplained,
    kind_of_predicted,
    parameter_text,
    probability_sentence,
    record_labels,
)
from scenarios.files.user_models import channel_units
from scenarios.files.writing import csv_text, study_folder, write_json, write_text
from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    NamedEffects,
    Pictured,
    Replicated,
)
from scenarios.preparation.recording import record_table
from scenarios.report.document import (
    PURE,
    Block,
    Bullets,
    Column,
    Fold,
    Page,
    Prose,
    Section,
    Table,
    now,
    reproduction,
    section,
)
from scenarios.report.document import Figure as PageFigure
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import UNDETERMINED, determined
from scenarios.report.terminal import p_value
from scenarios.stored_study import write_stored_study
from sim.declaration.proposal import GUARD

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- The part of a diagnosis that its figures show


def pictured(tracing: Tracing) -> Pictured:
    """Return the part of a diagnosis that figures show; diverged predictions are bounded."""
    d = as_declared(tracing.diagnosis)
    predictions = tuple(
        replace(
            prediction,
            before=bounded_series(prediction.before),
            after=bounded_series(prediction.after),
        )
        for prediction in d.predictions
    )
    claimed = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    standing = NamedEffects(
        tuple(claim.name for claim in claimed),
        {claim.name: claim.alternatives for claim in claimed if claim.alternatives},
        tuple(claim.name for claim in tracing.diagnosis.effects if not claim.claimed),
        d.verdict in (Verdict.CONSISTENT, Verdict.TRACED, Verdict.AMBIGUOUS),
    )
    return Pictured(
        d.fitted,
        predictions,
        d.candidates,
        d.before,
        d.after,
        d.noise_floor,
        standing,
        kind_of_predicted(d),
        _replicated(tracing),
        SIMULATED_DATA if tracing.simulated else MEASURED_DATA,
    )


def _replicated(tracing: Tracing) -> tuple[Replicated, ...]:
    labels = tuple(record_labels(tracing))
    claims = [claim for claim in tracing.diagnosis.effects if claim.by_record]
    return tuple(
        Replicated(claim.name, labels[: len(claim.by_record)], claim.by_record, claim.parameters)
        for claim in claims
    )


def bounded_series(values: np.ndarray) -> np.ndarray:
    """Return the values of a simulation, limited to +-``LARGEST``; NaN becomes ``LARGEST``."""
    return np.nan_to_num(np.clip(values, -LARGEST, LARGEST), nan=LARGEST)


# ---- The figures of a diagnosis

# File stem -> caption, in the order of the report; the stems of further records have a number.
RUN_TO_RUN = "Run-to-run: scatter of fits of single records, weighted by their sigmas."
CAPTIONS = {
    "replication": (
        "Parameters of the effects from each record alone, and from all fitted records together"
    ),
    "held_out": "Recorded and predicted outputs of data that were not fitted, with the residuals",
    "residuals": "Residuals of the fitted data with the declared model and with the effects",
    "evidence": (
        "Log posterior odds of each candidate effect (gain of the log evidence plus log prior "
        "odds; above zero the effect is more probable than its absence). Each panel compares with "
        "the set of effects in its heading, so bars of different panels have different "
        "references. Filled bars: fitted; open bars: linear estimate. At the right: why the effect "
        "was not chosen; a candidate may have a longer bar than a claimed effect, although no "
        "whole set with it is as probable"
    ),
    "derivatives": "Derivatives with the declared model and with the effects",
    "spectra": (
        "Power spectra of the residuals, divided by the spectrum of the noise, and coherence of "
        "the residuals with the inputs"
    ),
}
DECLARED_CAPTIONS = {  # captions if the figures show the declared model alone
    **CAPTIONS,
    "held_out": (
        "Outputs of data that were not fitted, recorded and predicted by the declared model, with "
        "the residuals"
    ),
    "residuals": "Residuals of the fitted data with the declared model",
    "derivatives": "Derivatives of the declared model",
}


def draw_diagnosis(
    shown: Pictured, folder: Path, formats: Formats = USUAL, *, declared: bool = False
) -> tuple[Drawn, ...]:
    """Write all figures into ``folder`` and return them for the page, in the order of the report.

    ``declared`` : the figures show the declared model alone.
    """
    from scenarios.plots.drawing import draw_for_page

    drawn = draw_for_page(figures_of(shown), folder, formats)
    plots = {figure.stem: figure.plot for figure in drawn}
    ordered = captioned({figure.stem: figure.svg for figure in drawn}, declared=declared)
    return tuple(replace(figure, plot=plots[figure.stem]) for figure in ordered)


def figures_of(pictured: Pictured) -> list[tuple[str, Callable[[], Figure]]]:
    """Return file stem and drawing function of each figure."""
    from scenarios.plots import tracing

    kind, noise = pictured.kind, pictured.noise
    drawings: dict[str, Callable[[], Figure]] = {}
    for number, prediction in enumerate(pictured.predictions):
        title = f"{prediction.record.name} ({kind}): {pictured.data} and predicted"
        drawings[numbered("held_out", number)] = partial(
            tracing.figure_held_out, prediction, noise, title, pictured.data
        )
    for number, fitted in enumerate(pictured.fitted):
        name = fitted.record.name
        drawings[numbered("residuals", number)] = partial(
            tracing.figure_residuals, fitted, noise, f"{name}: residuals"
        )
        drawings[numbered("spectra", number)] = partial(
            tracing.figure_spectra, fitted, noise, f"{name}: spectra of the residuals"
        )
    if pictured.candidates:
        drawings["evidence"] = partial(
            tracing.figure_evidence, pictured.candidates, pictured.standing, "Evidence"
        )
    if pictured.before and pictured.after:
        drawings["derivatives"] = partial(
            tracing.figure_derivatives, pictured.before, pictured.after, "Derivatives"
        )
    if pictured.replicated:
        drawings["replication"] = partial(
            tracing.figure_replication, pictured.replicated, "Parameters by record"
        )
    return list(drawings.items())


def numbered(stem: str, number: int) -> str:
    """Return the file stem of record ``number``: ``residuals`` for 0, ``residuals_2`` for 1."""
    return stem if number == 0 else f"{stem}_{number + 1}"


def captioned(drawn: Mapping[str, str], *, declared: bool = False) -> tuple[Drawn, ...]:
    """Return figures with their captions in the order of the report.

    Parameters
    ----------
    drawn : SVG text of each figure by file stem.
    declared : the figures show the declared model alone.
    """
    ordered = []
    for stem, caption in (DECLARED_CAPTIONS if declared else CAPTIONS).items():
        names = sorted(
            (name for name in drawn if re.fullmatch(rf"{stem}(_\d+)?", name)),
            key=lambda name: (len(name), name),
        )
        ordered += [Drawn(name, drawn[name], caption) for name in names]
    return tuple(ordered)


TONES = {
    Verdict.CONSISTENT: "good",
    Verdict.TRACED: "good",
    Verdict.PARTIAL: "fair",
    Verdict.AMBIGUOUS: "fair",
    Verdict.UNEXPLAINED: "open",
}
PRINTED_CANDIDATES = 10  # rows of the table of candidates on paper
CANDIDATES_NOTE = (
    "Added to: the set of effects without the candidate (within, in evidence.csv). Gain: increase "
    "of the log evidence when the candidate is added to it. Log odds: log posterior odds, "
    "the gain plus the log of the prior odds; above zero the candidate is more probable than its "
    "absence. Linearised: the gain is from the linearised model; the candidate was not fitted. "
    "Like: changes the outputs in nearly the same way."
)
REPLICATION_NOTE = (
    "What remains is not noise. So the evidence for an effect has to be spread over the records: "
    "its sum over its scatter between blocks of a second is z of Vuong's test. Values from each "
    "record have the derivatives in common."
)
GUARD_NOTE = (
    "A name that begins with guard: is a catch-all term, which stands for causes outside the "
    "library. It is never named; where it is the most probable, no effect is."
)


def diagnosis_page(
    tracing: Tracing, warnings: Sequence[str], drawn: Sequence[Drawn] = (), created: str = ""
) -> Page:
    """Return the page of a diagnosis.

    Parameters
    ----------
    tracing : the diagnosis.
    warnings : all warnings; those on the files are shown at the top, the others in a section.
    drawn : the figures.
    created : time stamp.
    """
    d = tracing.diagnosis
    page_figures = {figure.name: figure for figure in figures(drawn)}
    replication = page_figures.pop("figure-replication", None)
    further = Bullets(tuple(warning for warning in warnings if warning not in tracing.doubts))
    return Page(
        title=f"{tracing.vehicle.name}: what the {tracing.vehicle.model} model lacks",
        kind=text.subject(tracing),
        verdict=d.verdict.value,
        tone=TONES[d.verdict],
        sentence=d.verdict.sentence,
        summary=(f"{_capital(text.headline(tracing))}.",),
        warnings=tuple(f"{doubt}." for doubt in tracing.doubts),
        sections=(
            *section("Figures", *page_figures.values()),
            *_effects(tracing),
            *section("Warnings", further),
            *_replication(d, replication),
            *_kinematics(tracing),
            *_errors(tracing),
            *_derivatives(tracing),
            *section("The record as it was recorded", record_table(tracing.look)),
            *section("How the records were prepared", Bullets(tuple(tracing.notes))),
            *_search(tracing),
        ),
        reproduction=reproduction(_command(tracing), "", _inputs(tracing)),
        created=created,
    )


def _effects(tracing: Tracing) -> tuple[Section, ...]:
    advice = [
        Prose(f"Not claimed: {reason}.") for reason in text.unclaimed_reasons(tracing.diagnosis)
    ]
    for line in text.verdict_advice(tracing):
        before, _, command = line.partition(text.DESIGNED_BY)
        # A command to copy keeps its signs.
        designed = [Prose(_capital(text.DESIGNED_BY.strip())), Prose(command, "code")]
        advice += [Prose(f"{line}.")] if before else designed
    cards = tuple(_effect_card(claim, tracing) for claim in tracing.diagnosis.effects)
    return section("Effects", *advice, parts=cards) if cards or advice else ()


def _effect_card(claim: Claim, tracing: Tracing) -> Section:
    wording = text.wording_of(tracing)
    blocks: list[Block] = [Prose(f"{_capital(text.effect_heading(claim, wording))}.")]
    if probability := probability_sentence(claim):
        blocks.append(Prose(f"{probability}."))
    if parameters := parameter_text(claim, wording):
        blocks.append(Prose(parameters, "value"))
    blocks += [Prose(f"Not claimed: {reason}.") for reason in claim.reasons]
    if claim.alternatives:
        blocks.append(Prose(f"These data fit as well: {', '.join(claim.alternatives)}."))
    if explanation := claim.explanation or tracing.explanations.get(claim.name, ""):
        blocks.append(Fold("What this effect is", (explanation,)))
    return Section(claim.name, tuple(blocks), card="claim" if claim.claimed else "hint")


def _replication(d: Diagnosis, figure: PageFigure | None) -> tuple[Section, ...]:
    sentences = [
        Prose(f"{_capital('; '.join(evidence_sentences(claim)))}.", term=f"{claim.name}:")
        for claim in d.effects
        if evidence_sentences(claim)
    ]
    if not sentences:
        return ()
    return section("Replication", *sentences, figure, Prose(REPLICATION_NOTE, "note"))


def _kinematics(tracing: Tracing) -> tuple[Section, ...]:
    kinematics = tracing.kinematics
    if kinematics is None:
        return ()
    lines = kinematics_lines(kinematics, tracing.diagnosis.effects, text.wording_of(tracing))
    blocks: list[Block] = [Prose(f"{_capital(line)}.") for line in lines]
    if kinematics.records:
        note = (
            "This check has no aerodynamic model. It uses records of the diagnosis, so agreement "
            "supports the diagnosis and is not independent of it."
        )
        blocks.append(Prose(note, "note"))
    if kinematics.result is not None and kinematics.result.unobservable:
        limits = tuple(kinematics.result.unobservable)
        blocks.append(Fold("What these channels cannot show", limits))
    return section("Kinematics alone", *blocks)


def _errors(tracing: Tracing) -> tuple[Section, ...]:
    d = tracing.diagnosis
    if is_unexplained(d):
        note = (
            "No effect is named as the cause, so there is nothing to compare with the declared "
            "model."
        )
    elif declared_alone(d):
        note = "No effect is needed: the declared model is the only one."
    else:
        note = "Before: the declared model; after: with the effects."
    if simulation_note := tables.simulation_note(d):
        note += f" {_capital(simulation_note)}."
    explanation = (
        f"Root mean square of measured minus simulated on {text.where_predicted(tracing)}; only "
        f"initial states and biases were fitted there. {note}"
    )
    units = channel_units(tracing.model)
    table = tables.errors_table(d, "Simulation error", units)
    found = section("Simulation error", table, Prose(explanation, "note"))
    one_step = tables.one_step_table(d, units)
    return found if one_step is None else (*found, *section("One step ahead", one_step))


def _derivatives(tracing: Tracing) -> tuple[Section, ...]:
    d = tracing.diagnosis
    sigmas, title = tables.sigma_note(d), tables.moved_title(d)
    # "HEADING (NOTE)" or "HEADING: NOTE"
    heading, _, heading_note = title.partition(" (" if title.endswith(")") else ": ")
    scatter = f" {RUN_TO_RUN}" if d.scatter else ""
    levels = levels_table(tracing, "Levels of flying qualities")
    levels_heading, _, assumption = levels_title(tracing).partition(" (")
    levels_note = None
    if assumption and levels.rows:
        levels_note = Prose(f"{_capital(assumption.removesuffix(')'))}.", "note")
    parts = section(_capital(levels_heading), levels, levels_note)
    members_note = Prose(
        "These data cannot tell them apart. * differs from the first by more than two sigmas of "
        "both together.",
        "note",
    )
    for table in tables.member_tables(d, "Derivatives by member"):
        members = [column.heading for column in table.columns[1:]]
        parts += section(f"Under {' or '.join(members)}", members_note, table)
    return section(
        _capital(heading),
        Prose(f"{_capital(heading_note.removesuffix(')'))}.", "note") if heading_note else None,
        tables.derivatives_table(d, "Derivatives"),
        tables.derived_table(d, "Derived quantities"),
        Prose(
            f"{sigmas}; those of the frequency, the damping and the like follow.{scatter}", "note"
        )
        if sigmas
        else None,
        parts=parts,
    )


def _search(tracing: Tracing) -> tuple[Section, ...]:
    d = tracing.diagnosis
    effort = Prose(f"{_capital(effort_sentence(tracing.effort, d))}.", "note")
    steps = Bullets(tuple(step.sentence for step in d.steps), numbered=True)
    has_catch_all = any(candidate.name.startswith(GUARD) for candidate in d.candidates)
    caption = "Every candidate, the best of each round first"
    table = tables.candidates_table(d, caption, len(d.candidates), PRINTED_CANDIDATES)
    note = Prose(f"{CANDIDATES_NOTE} {GUARD_NOTE}" if has_catch_all else CANDIDATES_NOTE, "note")
    columns = (
        Column("model"),
        Column("test"),
        Column("channel"),
        Column("p", PURE),
        Column("result"),
    )
    rows = tuple(
        (model, test.name, test.channel, p_value(test.p_value), test.sentence)
        for model, tests in _tests(d)
        for test in tests
    )
    parts = section("Every candidate", table, note) if d.candidates else ()
    return section(
        "How it was found",
        steps,
        effort,
        parts=parts + section("Residual tests", Table("Residual tests", columns, rows)),
    )


def _tests(d: Diagnosis) -> list[tuple[str, tuple[ResidualTest, ...]]]:
    if declared_alone(d):
        return [(DECLARED, tuple(d.tests_before))]
    return [("before", tuple(d.tests_before)), ("after", tuple(d.tests_after))]


def _inputs(tracing: Tracing) -> list[tuple[str, str, str]]:
    kind = kind_of_predicted(tracing.diagnosis)
    files = [("fitted", file) for file in tracing.inputs.records] + [
        (kind, file) for file in tracing.inputs.validation
    ]
    files += [("vehicle", tracing.inputs.vehicle)] + [
        ("effects", file) for file in tracing.inputs.effects
    ]
    return [(use, file.name, file.sha256) for use, file in files]


def _command(tracing: Tracing) -> list[str]:
    inputs = tracing.inputs
    own = tracing.vehicle.own_file
    command = [
        "flightid",
        "diagnose",
        *(file.name for file in inputs.records),
        "--model",
        own.name if own is not None else tracing.vehicle.model,
    ]
    command += ["--vehicle", inputs.vehicle.name]
    if inputs.validation:
        command += ["--validate", *(file.name for file in inputs.validation)]
    return command


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


MAIN = "diagnosis.json"  # written last


def _unchanged(page: Page) -> Page:
    return page


def write_diagnosis(
    tracing: Tracing,
    folder: str | Path,
    *,
    figures: Formats = USUAL,
    dressed: Callable[[Page], Page] = _unchanged,
) -> Path:
    """Write all files of a diagnosis into ``folder``, or none after an error; return the folder.

    The files are ``validate_prediction.csv`` and ``residuals.csv`` (``..._2.csv`` and so on for
    further records), ``evidence.csv``, ``decides.csv`` for an ambiguous diagnosis, the figures in
    the formats ``figures``, ``report.html``, ``report.json`` and ``diagnosis.json``.
    ``dressed`` adds content of the caller to the page.
    """
    d, created = tracing.diagnosis, now()
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            drawn = draw_diagnosis(pictured(tracing), scratch, figures, declared=declared_alone(d))
        for number, prediction in enumerate(d.predictions):
            write_prediction(scratch / f"{numbered('validate_prediction', number)}.csv", prediction)
        for number, fitted in enumerate(d.fitted):
            write_residuals(scratch / f"{numbered('residuals', number)}.csv", fitted)
        write_evidence(scratch / "evidence.csv", d.candidates)
        content = diagnosis_content(tracing, created)
        write_page(scratch, dressed(diagnosis_page(tracing, content["warnings"], drawn, created)))
        stored = stored_diagnosis(tracing)
        if stored is not None:
            write_stored_study(scratch, stored)
        if tracing.decides is not None:
            from scenarios.maneuver_design.report import write_maneuver

            write_maneuver(scratch, tracing.decides.best, Path(DECIDES).stem)
        write_json(scratch / MAIN, content)
    return Path(folder)


def write_prediction(path: Path, prediction: Prediction) -> None:
    """Write ``time``, ``before_CHANNEL`` and ``after_CHANNEL`` in SI units (nz in g).

    Each sample of the record has a row, missing samples included.
    """
    header = [
        "time",
        *(f"{model}_{name}" for model in ("before", "after") for name in prediction.channels),
    ]
    rows = np.concatenate(
        [
            prediction.record.time[None, :],
            bounded_series(prediction.before),
            bounded_series(prediction.after),
        ]
    )
    _write(path, header, ([repr(cell) for cell in row] for row in rows.T.tolist()))


def write_residuals(path: Path, fitted: FittedRecord) -> None:
    """Write the residuals of a fitted record, measured minus simulated.

    The columns are ``time`` and, for each channel, ``before_CHANNEL``, ``after_CHANNEL`` and
    ``used_CHANNEL``. Cells of a missing sample are empty. ``used`` is 0 for a sample that is
    missing or was excluded from the fit.
    """
    header, columns = ["time"], [[repr(value) for value in fitted.record.time.tolist()]]
    for row, name in enumerate(fitted.channels):
        if name not in fitted.record.output_names:
            continue
        valid = fitted.record[name].valid
        header += [f"before_{name}", f"after_{name}", f"used_{name}"]
        for residual in (fitted.before[row], fitted.after[row]):
            columns.append(
                [
                    repr(value) if measured else ""
                    for value, measured in zip(
                        bounded_series(residual).tolist(), valid, strict=True
                    )
                ]
            )
        columns.append(["1" if used else "0" for used in (fitted.used[row] & valid).tolist()])
    _write(path, header, zip(*columns, strict=True))


def write_evidence(path: Path, candidates: Sequence[Candidate]) -> None:
    """Write one row for each candidate of each round; fitted candidates have parameters."""
    header = ["round", "within", "name", "gain", "weight", "fitted", "collinear_with", "parameters"]
    rows = [
        [
            str(candidate.round),
            " ".join(candidate.within),
            candidate.name,
            repr(bounded(candidate.gain)),
            repr(bounded(candidate.weight)),
            str(int(candidate.fitted)),
            " ".join(candidate.collinear_with),
            "; ".join(_cell(name, value) for name, value in candidate.parameters.items()),
        ]
        for candidate in candidates
    ]
    _write(path, header, rows)


def _cell(name: str, quantity: Quantity) -> str:
    if not determined(quantity.value, quantity.std):
        return f"{name} = {UNDETERMINED}"
    return f"{name} = {quantity.value:.6g} +- {quantity.std:.2g} {quantity.unit}"


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    write_text(path, csv_text(header, rows))
