"""A campaign of surrogate flights in tables, and as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from exam.repeated import Flown
from exam.scores.content import scores_content
from exam.scores.page import drawn_scores
from exam.scores.tables import SHARED, share_cells
from exam.scores.text import scores_blocks
from exam.surrogates.campaign import Judged, by_derivative, by_effect, scores_of, shares
from exam.surrogates.declaration import Surrogate
from scenarios.diagnosis.text import bounded
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json
from scenarios.report.document import PURE, Cell, Column, Number, Page, counted
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import write_page
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines
from scenarios.report.terminal import cell_text, rows_table, table_as_lines

SHARES = (Column("share"), *SHARED)
EFFECTS = (
    Column("hidden effect"),
    *(Column(heading, PURE) for heading in ("flights", "named alone", "in a group")),
)
DERIVATIVES = (
    Column("derivative"),
    *SHARED,
    Column("bias, median", PURE),
    Column("its size, median", PURE),
)
TITLE = (
    "within two sigmas of the pseudo-true value; apart from it the bias of that value against the "
    "nominal derivative"
)
_LABELS = {
    "named": "hidden effects named, alone or in a group",
    "named_alone": "hidden effects named alone",
    "false_claims": "flights with a claim that nothing true stands behind",
    "small_claims": "flights with a claim of a small cause that acts",
    "held_out_worse": "held-out error made worse than its scatter",
    "within_two_sigma": "derivatives within two sigmas of pseudo-true values",
}


def campaign_text(
    surrogate: Surrogate,
    judged: Sequence[Judged],
    seeds: str,
    width: int = WIDTH,
    details: str = BELOW,
) -> str:
    """A summary, shares with intervals, effect by effect, derivative by derivative; ``seeds`` in
    words.
    """
    rows = share_rows(judged)
    summary = Summary(
        f"{surrogate.name}: {surrogate.title}; {len(judged)} flights, {seeds}",
        verdict_counts(judged),
        "; ".join(f"{cell_text(row[0])} {cell_text(row[2])} ({row[3]})" for row in rows[:2]),
        details=details,
    )
    blocks = [
        summary_lines(summary, width),
        [f"{surrogate.name}: {len(judged)} flights, {seeds}", verdict_counts(judged)],
        table_as_lines(rows_table("", SHARES, rows), width),
        false_lines(judged),
        table_as_lines(rows_table("", EFFECTS, effect_rows(judged)), width),
        table_as_lines(rows_table(TITLE, DERIVATIVES, derivative_rows(judged)), width),
        *scores_blocks(scores_of(judged), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def verdict_counts(judged: Sequence[Judged]) -> str:
    """How often each verdict was given."""
    verdicts = {
        flight.verdict: sum(other.verdict == flight.verdict for other in judged)
        for flight in judged
    }
    return ", ".join(f"{count} {name}" for name, count in verdicts.items())


def share_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Cells below ``SHARES``."""
    found = shares(judged).items()
    return [(_LABELS[key], *share_cells(share)) for key, share in found if share.of]


def false_lines(judged: Sequence[Judged]) -> list[str]:
    """Every claim of what is not there."""
    return [
        f"seed {flight.seed}: {' and '.join(flight.false)} claimed, and not there"
        for flight in judged
        if flight.false
    ]


def effect_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Cells below ``EFFECTS``."""
    return [(name, *map(counted, counts)) for name, counts in by_effect(judged).items()]


def derivative_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Cells below ``DERIVATIVES``."""
    found = by_derivative(judged).items()
    return [
        (
            name,
            *share_cells(inside),
            Number(100.0 * middle, unit="%", shown=f"{100.0 * middle:+.1f} %"),
            Number(100.0 * size, unit="%", shown=f"{100.0 * size:.1f} %"),
        )
        for name, (inside, middle, size) in found
    ]


def write_campaign(
    surrogate: Surrogate,
    done: Flown,
    out: str | Path,
    paged: Callable[[Sequence[Drawn]], Page],
    figures: Formats = USUAL,
) -> Path:
    """Write ``flights.csv``, one row a flight, figures, the page that ``paged`` makes with them,
    and ``campaign.json`` (last).
    """
    judged: Sequence[Judged] = done.found
    scores = scores_of(judged)
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(
            ["seed", "verdict", "hidden", "named", "said", "false_claims", "small_claims", "worse"]
        )
        for flight in judged:
            lists = (
                [name for name, _ in flight.named],
                [each.name.lower() for _, each in flight.named],
                flight.claimed,
                flight.false,
                flight.small,
            )
            writer.writerow(
                [
                    flight.seed,
                    flight.verdict,
                    *(" + ".join(names) for names in lists),
                    int(flight.worse),
                ]
            )
        (scratch / "flights.csv").write_text(text.getvalue(), encoding="utf-8", newline="\n")
        found = {
            key: {"count": share.count, "of": share.of, "interval": list(share.interval)}
            for key, share in shares(judged).items()
        }
        content = {
            "schema": "flightid/campaign/1",
            "scenario": surrogate.name,
            **done.content,
            "shares": found,
            "effects": {
                name: {"flights": n, "alone": alone, "group": grouped}
                for name, (n, alone, grouped) in by_effect(judged).items()
            },
            "derivatives": {
                name: {
                    "within_two_sigma": inside.count,
                    "of": inside.of,
                    "bias": bounded(middle),
                    "bias_size": bounded(size),
                }
                for name, (inside, middle, size) in by_derivative(judged).items()
            },
            "marks": scores_content(scores),
            "versions": versions(),
        }
        write_page(scratch, paged(drawn_scores(scores, surrogate.name, scratch, figures)))
        write_json(scratch / "campaign.json", content)
    return Path(out)
