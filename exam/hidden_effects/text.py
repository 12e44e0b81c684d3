"""A campaign of a tracing scenario in tables, and as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from exam.hidden_effects.campaign import TraceJudged, scores_of, trace_shares, verdict_shares
from exam.repeated import Flown
from exam.scores.content import scores_content
from exam.scores.page import drawn_scores
from exam.scores.tables import SHARED, share_cells
from exam.scores.text import scores_blocks
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json
from scenarios.report.document import Cell, Column, Page
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import write_page
from scenarios.report.summary import WIDTH
from scenarios.report.terminal import rows_table, table_as_lines
from scenarios.trials.planted_declaration import TraceScenario

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
    """Verdicts and shares with their intervals, false claims one by one; ``seeds`` in words."""
    blocks = [
        [f"{scenario.name}: {len(judged)} flights, {seeds}", expected_line(scenario)],
        table_as_lines(rows_table("", VERDICTS, verdict_rows(judged))),
        table_as_lines(rows_table("", SHARES, share_rows(judged))),
        false_lines(judged),
        *scores_blocks(scores_of(judged), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def expected_line(scenario: TraceScenario) -> str:
    """Verdicts and effects that the scenario expects."""
    expected = (
        " or ".join(" + ".join(names) for names in scenario.expect.effects) or "nothing to claim"
    )
    return f"expected: {' or '.join(scenario.expect.verdicts)}, {expected}"


def verdict_rows(judged: Sequence[TraceJudged]) -> list[tuple[Cell, ...]]:
    """Cells below ``VERDICTS``."""
    return [(name, *share_cells(share)) for name, share in verdict_shares(judged).items()]


def share_rows(judged: Sequence[TraceJudged]) -> list[tuple[Cell, ...]]:
    """Cells below ``SHARES``."""
    return [
        (_LABELS[key], *share_cells(share))
        for key, share in trace_shares(judged).items()
        if share.of
    ]


def false_lines(judged: Sequence[TraceJudged]) -> list[str]:
    """Every claim of what is not there."""
    return [
        f"seed {flight.seed}: {' and '.join(flight.false)} claimed, and not there"
        for flight in judged
        if flight.false
    ]


def write_trace_campaign(
    scenario: TraceScenario,
    done: Flown,
    out: str | Path,
    paged: Callable[[Sequence[Drawn]], Page],
    figures: Formats = USUAL,
) -> Path:
    """Write ``flights.csv``, one row a flight, figures, the page that ``paged`` makes with them,
    and ``campaign.json`` (last).
    """
    judged: Sequence[TraceJudged] = done.found
    scores = scores_of(judged)
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["seed", "verdict", "grade", "said", "hidden", "named", "false_claims"])
        for flight in judged:
            lists = (
                flight.claimed,
                [name for name, _ in flight.named],
                [name for name, hit in flight.named if hit],
                flight.false,
            )
            writer.writerow(
                [
                    flight.seed,
                    flight.verdict,
                    flight.grade.name.lower(),
                    *(" + ".join(names) for names in lists),
                ]
            )
        (scratch / "flights.csv").write_text(text.getvalue(), encoding="utf-8", newline="\n")
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
            "shares": {
                key: {"count": share.count, "of": share.of, "interval": list(share.interval)}
                for key, share in shares.items()
                if share.of
            },
            "marks": scores_content(scores),
            "versions": versions(),
        }
        write_page(scratch, paged(drawn_scores(scores, scenario.name, scratch, figures)))
        write_json(scratch / "campaign.json", content)
    return Path(out)
