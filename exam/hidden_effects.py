"""Campaigns of hidden-effect scenarios: many flights of one scenario, tables, files and page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from exam.options import exam_reproduction
from exam.repeated import FlownCampaign, LoopFlights
from exam.scores.rates import Scores, hidden_label
from exam.scores.report import (
    SHARED,
    scores_blocks,
    scores_sections,
    share_cells,
    share_content,
    write_campaign_folder,
)
from exam.scores.scored_flight import (
    ScoredFlight,
    claims_of,
    is_curve,
    outcome_of,
    over_noise,
    parameter_errors,
    plain_name,
    stated_by,
)
from exam.scoring import Share, same_fault, share_of_flights, share_within_flights
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.report.document import Cell, Column, Page, as_sentence, capital, now, section
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.summary import WIDTH
from scenarios.report.terminal import rows_table, table_as_lines
from scenarios.studies.catalogue import load_document
from scenarios.trials.planted_declaration import Grade, TraceScenario
from scenarios.trials.planted_flights import trace_scenario_of
from scenarios.trials.planted_study import TraceStudy, run_trace

# ---- Many flights of one tracing scenario

SIGMAS = 2.0


@dataclass(frozen=True)
class TraceJudged:
    """One flight of a tracing scenario.

    ``claimed`` has the claims with their alternatives, ``"a/b"``. ``named`` has each hidden effect
    of the library, and whether a claim names it; ``alone`` are those that are named without an
    alternative. ``false`` are claims that do not correspond to any true cause. ``inside`` has, for
    each derivative, whether its interval of two sigmas, with the claimed effects, contains the
    truth.
    """

    seed: int
    verdict: str
    grade: Grade
    claimed: tuple[str, ...]
    named: tuple[tuple[str, bool], ...]
    alone: tuple[str, ...]
    false: tuple[str, ...]
    inside: tuple[tuple[str, bool], ...]
    marked: ScoredFlight | None = None


def judge_trace(scenario: TraceScenario, seed: int) -> TraceJudged:
    """Fly and diagnose one flight, and compare the diagnosis with the hidden effects."""
    study = run_trace(scenario, seed)
    judged = judged_of(study)
    return replace(judged, marked=scored_flight_of(study, judged))


def scored_flight_of(study: TraceStudy, judged: TraceJudged) -> ScoredFlight:
    """Return the score of a flight for the statistics that all campaigns have in common."""
    d, claims = study.tracing.diagnosis, claims_of(study.tracing.diagnosis)
    right = frozenset(plain_name(name) for name in _true_names(study))
    truth = {name: values for name, values in study.simulated.hidden.items() if not is_curve(name)}
    return ScoredFlight(
        tuple(study.simulated.hidden),
        d.verdict.value,
        outcome_of(d.verdict.value, claims),
        tuple(claim.name for claim in claims),
        study.grade in (Grade.RIGHT, Grade.AMBIGUOUS),
        judged.false,
        stated_by(claims, right),
        parameter_errors(claims, truth),
        over_noise(d.error_before, study.simulated.noise_std),
        over_noise(d.error_after, study.simulated.noise_std),
    )


def _true_names(study: TraceStudy) -> frozenset[str]:
    """Return the names that count as true: hidden effects, names that the scenario accepts, and
    names of the same faults.
    """
    accepted = {name for names in study.scenario.expect.effects for name in names}
    return frozenset().union(*(same_fault(name) for name in {*accepted, *study.simulated.hidden}))


def judged_of(study: TraceStudy) -> TraceJudged:
    """Compare a tracing study with its truth; names that the scenario accepts are not false."""
    claims = [claim for claim in study.tracing.diagnosis.effects if claim.claimed]
    accepted = {name for names in study.scenario.expect.effects for name in names}
    hidden = [name for name in study.simulated.hidden if name in accepted] or (
        [*study.scenario.expect.effects[0]] if accepted else []
    )
    true = _true_names(study)
    return TraceJudged(
        study.seed,
        study.tracing.diagnosis.verdict.value,
        study.grade,
        tuple("/".join(_group(claim)) for claim in claims),
        tuple(
            (name, any(same_fault(name) & {*_group(claim)} for claim in claims)) for name in hidden
        ),
        tuple(
            name
            for name in hidden
            if any(claim.name in same_fault(name) and not claim.alternatives for claim in claims)
        ),
        tuple("/".join(_group(claim)) for claim in claims if not true & {*_group(claim)}),
        tuple((row.name, abs(row.sigmas) < SIGMAS) for row in study.derivatives),
    )


def trace_flights(name: str, changes: Sequence[str] = ()) -> LoopFlights:
    """Return the tasks of a tracing scenario by its name or the path of its file."""
    # The scenario is given by its name, because a user model consists of functions, which cannot be
    # sent to another process.
    document, short, _ = load_document(name, changes)
    return LoopFlights(
        short,
        partial(_judge_named, name, tuple(changes)),
        TraceJudged,
        {"scenario": document, "files": files_of(document)},
    )


def files_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the users' model files that a scenario names, by the hashes of their bytes."""
    named = [
        value for table in document.values() if isinstance(table, dict) for value in table.values()
    ]
    paths = sorted(
        {
            value
            for value in (*document.values(), *named)
            if isinstance(value, str) and value.endswith(".py")
        }
    )
    return {
        path: sha256(Path(path).read_bytes()).hexdigest() for path in paths if Path(path).is_file()
    }


def _judge_named(name: str, changes: tuple[str, ...], number: int, seed: int) -> TraceJudged:
    return judge_trace(named_scenario(name, changes), seed)


def named_scenario(name: str, changes: tuple[str, ...]) -> TraceScenario:
    """Return a tracing scenario with changed entries, by its name or the path of its file."""
    return trace_scenario_of(*load_document(name, changes))


def scores_of(judged: Sequence[TraceJudged]) -> Scores:
    """Return the flights for the statistics that all campaigns have in common."""
    marked = [flight.marked for flight in judged if flight.marked is not None]
    return Scores(marked, [hidden_label(each) for each in marked])


def verdict_shares(judged: Sequence[TraceJudged]) -> dict[str, Share]:
    """Return the share of each verdict."""
    return {
        verdict.value: share_of_flights(flight.verdict == verdict.value for flight in judged)
        for verdict in Verdict
    }


def trace_shares(judged: Sequence[TraceJudged]) -> dict[str, Share]:
    """Return the main shares of the campaign, by their names in ``campaign.json``."""
    return {
        "expected": share_of_flights(flight.grade is Grade.RIGHT for flight in judged),
        "expected_or_alternative": share_of_flights(
            flight.grade in (Grade.RIGHT, Grade.AMBIGUOUS) for flight in judged
        ),
        "named": share_within_flights([hit for _, hit in flight.named] for flight in judged),
        "named_alone": share_within_flights(
            [name in flight.alone for name, _ in flight.named] for flight in judged
        ),
        "false_claims": share_of_flights(bool(flight.false) for flight in judged),
        "within_two_sigma": share_within_flights(
            [hit for _, hit in flight.inside] for flight in judged
        ),
    }


def _group(claim: Claim) -> tuple[str, ...]:
    return claim.name, *claim.alternatives


# ---- A campaign of a tracing scenario in tables, and as files

VERDICTS = (Column("verdict"), replace(SHARED[0], heading="flights"), *SHARED[1:])
SHARES = (Column("share"), *SHARED)
_LABELS = {
    "expected": "flights with the expected answer",
    "expected_or_alternative": "the same, one name among its alternatives",
    "named": "hidden effects named, alone or in a group",
    "named_alone": "hidden effects named alone",
    "false_claims": "flights with a claim that nothing true stands behind",
    "within_two_sigma": "derivatives within two sigmas of what the fitted model should find",
}


def trace_campaign_text(
    scenario: TraceScenario, judged: Sequence[TraceJudged], seeds: str, width: int = WIDTH
) -> str:
    """Return verdicts and shares with their intervals, and each false claim; ``seeds`` is a
    text.
    """
    blocks = [
        [f"{scenario.name}: {len(judged)} flights, {seeds}", expected_line(scenario)],
        table_as_lines(rows_table("", VERDICTS, verdict_rows(judged))),
        table_as_lines(rows_table("", SHARES, share_rows(judged))),
        false_lines(judged),
        *scores_blocks(scores_of(judged), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def expected_line(scenario: TraceScenario) -> str:
    """Return the verdicts and effects that the scenario expects."""
    expected = (
        " or ".join(" + ".join(names) for names in scenario.expect.effects) or "nothing to claim"
    )
    return f"expected: {' or '.join(scenario.expect.verdicts)}, {expected}"


def verdict_rows(judged: Sequence[TraceJudged]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``VERDICTS``."""
    return [(name, *share_cells(share)) for name, share in verdict_shares(judged).items()]


def share_rows(judged: Sequence[TraceJudged]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``SHARES``."""
    return [
        (_LABELS[key], *share_cells(share))
        for key, share in trace_shares(judged).items()
        if share.of
    ]


def false_lines(judged: Sequence[TraceJudged]) -> list[str]:
    """Return a line for each false claim."""
    return [
        f"seed {flight.seed}: {' and '.join(flight.false)} claimed, and not there"
        for flight in judged
        if flight.false
    ]


def write_trace_campaign(
    scenario: TraceScenario,
    done: FlownCampaign,
    out: str | Path,
    paged: Callable[[Sequence[Drawn]], Page],
    figures: Formats = USUAL,
) -> Path:
    """Write ``flights.csv`` with a row for each flight, figures, the page that ``paged`` makes with
    them, and ``campaign.json`` (last).
    """
    judged: Sequence[TraceJudged] = done.found
    rows = [
        [
            flight.seed,
            flight.verdict,
            flight.grade.name.lower(),
            *map(
                " + ".join,
                (
                    flight.claimed,
                    [name for name, _ in flight.named],
                    [name for name, hit in flight.named if hit],
                    flight.false,
                ),
            ),
        ]
        for flight in judged
    ]
    shares = {
        **{f"verdict.{name}": share for name, share in verdict_shares(judged).items()},
        **trace_shares(judged),
    }
    content = {
        "schema": "flightid/campaign/1",
        "scenario": scenario.name,
        **done.content,
        "expected": {
            "verdicts": list(scenario.expect.verdicts),
            "effects": [list(names) for names in scenario.expect.effects],
        },
        "shares": {key: share_content(share) for key, share in shares.items() if share.of},
    }
    columns = ("seed", "verdict", "grade", "said", "hidden", "named", "false_claims")
    return write_campaign_folder(
        out, scenario.name, scores_of(judged), columns, rows, content, paged, figures
    )


# ---- The page of a campaign of a hidden-effect scenario


def campaign_page(
    scenario: TraceScenario, done: FlownCampaign, drawn: Sequence[Drawn] = ()
) -> Page:
    """Return the page of a campaign with the figures ``drawn``: verdicts and shares with their
    intervals, names, probabilities, sigmas.
    """
    judged: Sequence[TraceJudged] = done.found
    shares, false = trace_shares(judged), false_lines(judged)
    right = shares["expected"]
    command = ("hidden-effects", scenario.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(scenario.title)}: {len(judged)} flights",
        kind=f"Campaign of {scenario.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=f"{right.count} of {right.of} flights give the expected answer.",
        summary=(as_sentence(expected_line(scenario)),),
        warnings=tuple(map(as_sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section(
                "Verdicts",
                rows_table("Verdicts with their 95 % intervals", VERDICTS, verdict_rows(judged)),
            ),
            *section(
                "How often the loop is right",
                rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged)),
            ),
            *scores_sections(scores_of(judged), drawn),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )
