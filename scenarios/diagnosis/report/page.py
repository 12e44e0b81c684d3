"""The page of a diagnosis: verdict, effects, errors, derivatives, figures, evidence; whole in one file."""

from __future__ import annotations

import base64
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from scenarios.diagnosis.effort import effort_sentence
from scenarios.diagnosis.report import text
from scenarios.diagnosis.report.candidate_tables import candidate_rows, weighed_rows
from scenarios.diagnosis.report.declared_only import DECLARED, nothing_stands, shown_columns, shown_rows
from scenarios.diagnosis.report.evidence import evidence_sentences, member_tables
from scenarios.diagnosis.report.figures import CAPTIONS, figure_stems
from scenarios.diagnosis.report.kinematics_text import kinematics_lines
from scenarios.diagnosis.report.mode_levels import LEVEL_HEADINGS, level_rows, levels_title
from scenarios.diagnosis.report.probabilities import probability_sentence
from scenarios.diagnosis.report.wording import parameter_text
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.own_models import channel_units
from scenarios.preparation.record_words import record_rows
from sim.declaration.traits import GUARD

if TYPE_CHECKING:
    from jinja2 import Template

TONES = {
    Verdict.CONSISTENT: "good",
    Verdict.TRACED: "good",
    Verdict.PARTIAL: "fair",
    Verdict.AMBIGUOUS: "fair",
    Verdict.UNEXPLAINED: "open",
}


def report_template() -> Template:
    """The page's template; every text that goes into it is escaped."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["signs"] = lambda words: words.replace("+-", "±").replace("->", "→")
    return environment.from_string(_resource("diagnosis.html"))


def diagnosis_page(tracing: Tracing, warnings: list[str], figures: Path, template: Template | None = None) -> str:
    """The page as HTML; the PNG files of our figures in the folder ``figures`` are put into it."""
    from markupsafe import Markup

    d = tracing.diagnosis
    page = template or report_template()
    return page.render(
        style=Markup(_resource("report.css")),
        title=f"{tracing.vehicle.name}: {d.verdict.value}",
        tone=TONES[d.verdict],
        verdict=d.verdict.value,
        verdict_sentence=d.verdict.sentence,
        subject=text.subject(tracing),
        headline=_capital(text.headline(tracing)),
        effects=[_effect(claim, tracing) for claim in d.effects],
        advice=text.verdict_advice(tracing),
        doubts=tracing.doubts,
        warnings=[warning for warning in warnings if warning not in tracing.doubts],
        notes=(*tracing.notes, effort_sentence(tracing.effort, tracing.diagnosis)),
        recorded=record_rows(tracing.look),
        where=text.where_predicted(tracing),
        nothing_stands=nothing_stands(d),
        errors=shown_rows(d, ("", *text.error_headings(d)), text.error_rows(d, channel_units(tracing.model))),
        error_headings=shown_columns(d, text.error_headings(d))[1:],
        kinematics=_kinematics(tracing),
        replicated=[_replicated(claim) for claim in d.effects if claim.evidence is not None],
        replication=_figure(figures / "replication.png", CAPTIONS["replication"]) if (figures / "replication.png").is_file() else None,
        weighed=weighed_rows(d),
        headings=shown_columns(d, text.derivative_headings(d))[1:],
        derived_headings=shown_columns(d, text.DERIVED_HEADINGS)[1:],
        members=member_tables(d),
        sigma_note=text.sigma_note(d),
        scatter=bool(d.scatter),
        derivatives=shown_rows(d, ("", *text.derivative_headings(d)), text.derivative_rows(d.before, d.after, d.scatter)),
        derived=shown_rows(d, ("", *text.DERIVED_HEADINGS), text.derived_rows(d)),
        levels=shown_rows(d, ("", *LEVEL_HEADINGS), level_rows(tracing)),
        level_headings=shown_columns(d, LEVEL_HEADINGS),
        levels_title=_capital(levels_title(tracing)),
        moved_title=_capital(text.moved_title(d)),
        figures=[
            _figure(figures / f"{stem}.png", caption) for stem, caption in figure_stems(figures, declared=nothing_stands(d)) if stem != "replication"
        ],
        steps=[step.sentence for step in d.steps],
        candidates=candidate_rows(d, len(d.candidates)),
        guarded=any(candidate.name.startswith(GUARD) for candidate in d.candidates),
        tests=[(when, test) for when, tests in _tests(d) for test in tests],
        inputs=[("fitted", file) for file in tracing.inputs.records]
        + [(text.kind_of_predicted(d), file) for file in tracing.inputs.validation]
        + [("vehicle", tracing.inputs.vehicle)]
        + [("effects", file) for file in tracing.inputs.effects],
    )


def _tests(d: Diagnosis) -> list[tuple[str, tuple[ResidualTest, ...]]]:
    if nothing_stands(d):
        return [(DECLARED, tuple(d.tests_before))]
    return [("before", tuple(d.tests_before)), ("after", tuple(d.tests_after))]


def _effect(claim: Claim, tracing: Tracing) -> dict[str, Any]:
    wording = text.wording_of(tracing)
    return {
        "name": claim.name,
        "claimed": claim.claimed,
        "sentence": _capital(text.effect_heading(claim, wording)),
        "probability": probability_sentence(claim),
        "parameters": parameter_text(claim, wording),
        "alternatives": claim.alternatives,
        "explanation": claim.explanation or tracing.explanations.get(claim.name, ""),
    }


def _replicated(claim: Claim) -> dict[str, Any]:
    told = " ".join(evidence_sentences(claim))
    return {"name": claim.name, "told": _capital(told)}


def _kinematics(tracing: Tracing) -> dict[str, Any] | None:
    some = tracing.kinematics
    if some is None:
        return None
    lines = kinematics_lines(some, tracing.diagnosis.effects, text.wording_of(tracing))
    limits = list(some.result.cannot_tell) if some.result is not None else []
    return {"records": ", ".join(some.records), "lines": [_capital(line) for line in lines], "limits": limits}


def _figure(path: Path, caption: str) -> dict[str, str]:
    return {"caption": caption, "data": base64.b64encode(path.read_bytes()).decode("ascii"), "name": path.stem}


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _resource(name: str) -> str:
    return files("scenarios.diagnosis.report").joinpath(name).read_text(encoding="utf-8")
