"""The statistics of a campaign of the loop for ``campaign.json``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from exam.scores.coverage import SIGMAS, coverage_of
from exam.scores.probabilities import brier, reliability_of
from exam.scores.rates import Scores, false_share, outcomes, right_share, standings
from exam.scores.scored_flight import ScoredFlight
from exam.scoring import Share


def scores_content(scores: Scores) -> dict[str, Any]:
    """Rates by label, conclusions, false names where nothing is hidden, probabilities of names,
    coverage; shares as count, of and interval.
    """
    flights = scores.flights
    score = brier(flights)
    return {
        "rates": {label: _rates(group) for label, group in scores.groups.items()},
        "all": _rates(flights),
        "concluded": {label: dict(row) for label, row in scores.confusion.items()},
        "false_names_on_clean": share_content(
            false_share([each for each in flights if not each.hidden])
        ),
        "reliability": [
            {**asdict(item), "interval": list(item.interval)} for item in reliability_of(flights)
        ],
        **({} if score is None else {"brier": {**asdict(score), "interval": list(score.interval)}}),
        "coverage": {
            label: {
                f"within_{k}_sigma": share_content(share)
                for k, share in zip(SIGMAS, shares, strict=True)
            }
            for label, shares in coverage_of(scores).items()
        },
    }


def score_cells(flight: ScoredFlight) -> dict[str, Any]:
    """A flight as cells of a row; None where there is no such thing. ``error_sigmas`` is the
    largest of the parameters' errors.
    """
    errors, first = (
        [*flight.errors.values()],
        next((each for each in flight.stated if each.first), None),
    )
    return {
        **{
            "hidden": " + ".join(flight.hidden),
            "verdict": flight.verdict,
            "outcome": flight.outcome.value,
            "right": flight.right,
        },
        **{
            "name": " + ".join(flight.given),
            "false": " + ".join(flight.false),
            "probability": first.probability if first else None,
        },
        **{
            "error_sigmas": max(errors, key=abs) if errors else None,
            "errors": json.dumps(dict(flight.errors)),
        },
        **{"held_out_before": flight.held_out_before, "held_out_after": flight.held_out_after},
    }


def share_content(share: Share) -> dict[str, Any]:
    """A share as plain data."""
    return {"count": share.count, "of": share.of, "interval": list(share.interval)}


def _rates(flights: Sequence[ScoredFlight]) -> dict[str, Any]:
    return {
        "right": share_content(right_share(flights)),
        "false": share_content(false_share(flights)),
        "outcomes": {
            outcome.value: share_content(share) for outcome, share in outcomes(flights).items()
        },
        "standings": {
            standing.value: share.count for standing, share in standings(flights).items()
        },
    }
