"""Many flights of one surrogate flight: rates of names, and coverage of intervals; tables and
files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from exam.repeated import FlownCampaign, LoopFlights
from exam.scores.rates import Scores, hidden_label
from exam.scores.report import (
    SHARED,
    scores_blocks,
    share_cells,
    share_content,
    write_campaign_folder,
)
from exam.scores.scored_flight import (
    ScoredFlight,
    claims_of,
    outcome_of,
    over_noise,
    parameter_errors,
    plain_name,
    stated_by,
)
from exam.scoring import Share, same_fault, share_of_flights, share_within_flights
from exam.surrogates.declaration import Surrogate
from exam.surrogates.pseudo_true import PseudoTrue, has_limit, pseudo_true
from exam.surrogates.study import Naming, Progress, SurrogateStudy, acts, run_surrogate
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.text import bounded
from scenarios.report.document import PURE, Cell, Column, Number, Page, counted
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines
from scenarios.report.terminal import cell_text, rows_table, table_as_lines
from scenarios.studies.campaign import plain
from sim.declaration.proposal import RangedCurve
from sim.errors import FlightidError

# ---- Many flights of one surrogate flight

BLOCK = 1.0  # s, blocks of held-out error, longer than the correlation time of residuals
SIGMAS = 2.0
SPREAD = 1_000_003  # offset between the seeds of flights and of their pseudo-true values


@dataclass(frozen=True)
class Judged:
    """One flight: hidden effects and how they were named, false claims, and whether the held-out
    error increased by more than its scatter.

    ``claimed`` has claims and hints (in parentheses) with their alternatives. ``errors`` has, by
    derivative, the estimate minus the pseudo-true value over the reported sigma. ``bias`` has the
    pseudo-true minus the nominal value, relative to the latter. Both are empty without pseudo-true
    values.
    """

    seed: int
    verdict: str
    claimed: tuple[str, ...]
    named: tuple[tuple[str, Naming], ...]
    false: tuple[str, ...]
    small: tuple[str, ...]
    worse: bool
    errors: Mapping[str, float]
    bias: Mapping[str, float]
    marked: ScoredFlight | None = None


def judge_flight(
    surrogate: Surrogate, seed: int, progress: Progress = lambda stage, share: None
) -> Judged:
    """Fly and diagnose one flight, and compare the diagnosis with the truth and, with ``draws``
    above zero, with pseudo-true values.
    """
    study = run_surrogate(surrogate, seed, progress)
    limit = reference(study) if surrogate.draws else None
    found = claimed_model(study)
    errors = (
        {name: (found[name].value - limit.values[name]) / found[name].std for name in found}
        if limit
        else {}
    )
    bias = {row.name: limit.bias(row.name) for row in study.derivatives} if limit else {}
    d = study.tracing.diagnosis
    said = tuple(map(_said, d.effects))
    return Judged(
        seed,
        d.verdict.value,
        said,
        study.named,
        study.false,
        study.small,
        worsened(study),
        errors,
        bias,
        scored_flight_of(study),
    )


def scored_flight_of(study: SurrogateStudy) -> ScoredFlight:
    """Return the score of a flight for the statistics that all campaigns have in common.

    It is right if the dominant effects are named and no claim is false. A small cause that acts is
    not a false name.
    """
    d, claims = study.tracing.diagnosis, claims_of(study.tracing.diagnosis)
    right = frozenset().union(*(same_fault(name) for name, _ in study.named))
    acting = {
        name for claim in claims for name in claim.probability if acts(name, study.surrogate.causes)
    }
    truth = {
        each.name: each.values
        for each in study.flight.drawn.hidden
        if not isinstance(each.effect, RangedCurve)
    }
    missed = any(how is Naming.MISSED for _, how in study.named)
    noise = study.surrogate.causes.noise_std
    return ScoredFlight(
        tuple(name for name, _ in study.named),
        d.verdict.value,
        outcome_of(d.verdict.value, claims),
        tuple(claim.name for claim in claims),
        not (missed or study.false),
        study.false,
        stated_by(claims, frozenset(map(plain_name, {*right, *acting}))),
        parameter_errors(claims, truth),
        over_noise(d.error_before, noise),
        over_noise(d.error_after, noise),
    )


def _said(claim: Claim) -> str:
    group = "/".join((claim.name, *claim.alternatives))
    return group if claim.claimed else f"({group})"


def claimed_model(study: SurrogateStudy) -> dict[str, Quantity]:
    """Return the derivatives of the declared model with the claimed effects.

    Without a claim they are those before the search, since hints are not claims.
    """
    claimed = any(claim.claimed for claim in study.tracing.diagnosis.effects)
    return {row.name: row.after if claimed else row.before for row in study.derivatives}


def reference(study: SurrogateStudy) -> PseudoTrue | None:
    """Return the pseudo-true values of the declared model with the claimed effects; None if it
    cannot be fitted to one flight or to many (``has_limit``).
    """
    claims = {
        c.name: {k: q.value for k, q in c.parameters.items()}
        for c in study.tracing.diagnosis.effects
        if c.claimed
    }
    rng = np.random.default_rng((SPREAD, study.seed))
    try:
        if not has_limit(study.flight.drawn, claims):
            return None
        found = {name: quantity.value for name, quantity in claimed_model(study).items()}
        return pseudo_true(
            study.flight.drawn,
            claims,
            study.surrogate.draws,
            rng,
            len(study.tracing.records),
            found,
        )
    except (FlightidError, np.linalg.LinAlgError):
        return None


def worsened(study: SurrogateStudy) -> bool:
    """Return whether the held-out error, all channels scaled, increased by more than two sigmas of
    its blocks.
    """
    changes: list[float] = []
    for p in study.tracing.diagnosis.predictions:
        z, valid = p.record.output_array(p.channels)
        before, after = (np.where(valid, z - y, 0.0) for y in (p.before, p.after))
        scale = np.mean(before**2, axis=1, keepdims=True) + 1e-300
        change = np.mean((after**2 - before**2) / scale, axis=0)
        size = max(1, round(BLOCK / float(np.median(np.diff(p.record.time)))))
        changes += [
            float(np.mean(change[at : at + size])) for at in range(0, len(change) - size + 1, size)
        ]
    return bool(np.mean(changes) > SIGMAS * np.std(changes, ddof=1) / np.sqrt(len(changes)))


def scores_of(judged: Sequence[Judged]) -> Scores:
    """Return the flights for the statistics that all campaigns have in common."""
    marked = [flight.marked for flight in judged if flight.marked is not None]
    return Scores(marked, [hidden_label(each) for each in marked])


def surrogate_flights(surrogate: Surrogate) -> LoopFlights:
    """Return the tasks of a surrogate flight, each diagnosed and judged."""
    return LoopFlights(
        surrogate.name, partial(_judge, surrogate), Judged, {"surrogate": plain(surrogate)}
    )


def _judge(surrogate: Surrogate, number: int, seed: int) -> Judged:
    return judge_flight(surrogate, seed)


def shares(judged: Sequence[Judged]) -> dict[str, Share]:
    """Return the main shares of the campaign, by their names in ``campaign.json``."""
    return {
        "named": share_within_flights(
            [how is not Naming.MISSED for _, how in flight.named] for flight in judged
        ),
        "named_alone": share_within_flights(
            [how is Naming.ALONE for _, how in flight.named] for flight in judged
        ),
        "false_claims": share_of_flights(bool(flight.false) for flight in judged),
        "small_claims": share_of_flights(bool(flight.small) for flight in judged),
        "held_out_worse": share_of_flights(flight.worse for flight in judged),
        "within_two_sigma": share_within_flights(
            [abs(value) < SIGMAS for value in flight.errors.values()] for flight in judged
        ),
    }


def by_effect(judged: Sequence[Judged]) -> dict[str, tuple[int, int, int]]:
    """Return, by hidden effect, the numbers of flights, of names alone, and of names in a group."""
    rows: dict[str, tuple[int, int, int]] = {}
    for name, how in sorted(
        (pair for flight in judged for pair in flight.named), key=lambda pair: pair[0]
    ):
        count, alone, grouped = rows.get(name, (0, 0, 0))
        rows[name] = (count + 1, alone + (how is Naming.ALONE), grouped + (how is Naming.IN_GROUP))
    return rows


def by_derivative(judged: Sequence[Judged]) -> dict[str, tuple[Share, float, float]]:
    """Return, by derivative, the share within two sigmas of the pseudo-true value, and the median
    and the median size of its bias.
    """
    names = list(dict.fromkeys(name for flight in judged for name in flight.errors))
    out = {}
    for name in names:
        bias = np.array([flight.bias[name] for flight in judged if name in flight.bias])
        inside = share_of_flights(
            abs(flight.errors[name]) < SIGMAS for flight in judged if name in flight.errors
        )
        out[name] = (inside, float(np.median(bias)), float(np.median(np.abs(bias))))
    return out


# ---- A campaign of surrogate flights in tables, and as files

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
    """Return a summary, shares with intervals, and tables by effect and by derivative; ``seeds`` is
    a text.
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
    """Return the number of flights with each verdict."""
    verdicts = {
        flight.verdict: sum(other.verdict == flight.verdict for other in judged)
        for flight in judged
    }
    return ", ".join(f"{count} {name}" for name, count in verdicts.items())


def share_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``SHARES``."""
    found = shares(judged).items()
    return [(_LABELS[key], *share_cells(share)) for key, share in found if share.of]


def false_lines(judged: Sequence[Judged]) -> list[str]:
    """Return a line for each false claim."""
    return [
        f"seed {flight.seed}: {' and '.join(flight.false)} claimed, and not there"
        for flight in judged
        if flight.false
    ]


def effect_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``EFFECTS``."""
    return [(name, *map(counted, counts)) for name, counts in by_effect(judged).items()]


def derivative_rows(judged: Sequence[Judged]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``DERIVATIVES``."""
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
    done: FlownCampaign,
    out: str | Path,
    paged: Callable[[Sequence[Drawn]], Page],
    figures: Formats = USUAL,
) -> Path:
    """Write ``flights.csv`` with a row for each flight, figures, the page that ``paged`` makes with
    them, and ``campaign.json`` (last).
    """
    judged: Sequence[Judged] = done.found
    rows = [
        [
            flight.seed,
            flight.verdict,
            *map(
                " + ".join,
                (
                    [name for name, _ in flight.named],
                    [each.name.lower() for _, each in flight.named],
                    flight.claimed,
                    flight.false,
                    flight.small,
                ),
            ),
            int(flight.worse),
        ]
        for flight in judged
    ]
    content = {
        "schema": "flightid/campaign/1",
        "scenario": surrogate.name,
        **done.content,
        "shares": {key: share_content(share) for key, share in shares(judged).items()},
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
    }
    columns = (
        *("seed", "verdict", "hidden", "named"),
        *("said", "false_claims", "small_claims", "worse"),
    )
    return write_campaign_folder(
        out, surrogate.name, scores_of(judged), columns, rows, content, paged, figures
    )
