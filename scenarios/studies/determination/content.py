"""What records and priors determine, for ``comparison.json`` and as a table with a row for each method and parameter."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from scenarios.studies.determination.determine import MethodDetermination

HEADINGS = ("method", "parameter", "prior_std", "std", "std_over_prior", "share_from_prior", "claimed_std")
FEW = 6  # parts of a direction that are written


def determination_content(method: MethodDetermination) -> dict[str, Any]:
    """Counts, every strength, the directions that the record sees, and of each parameter what comes from where."""
    found = method.found
    return {
        "parameters_estimated": len(found.names),
        "numbers_determined": found.effective,
        "directions_determined": found.determined,
        "directions_unseen": found.unseen,
        "strengths": found.strengths.tolist(),
        "directions": [
            {"strength": float(found.strengths[at]), "parts": dict(found.composition(at, FEW))} for at in range(len(found.names) - found.unseen)
        ],
        "parameters": {
            name: {"prior_std": float(prior), "std": float(std), "share_from_prior": float(share), "claimed_std": float(claimed)}
            for name, prior, std, share, claimed in _rows(method)
        },
        "overclaimed": list(method.overclaimed),
    }


def determination_csv(methods: Sequence[MethodDetermination]) -> str:
    """The parameters of all methods."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    for method in methods:
        for name, prior, std, share, claimed in _rows(method):
            numbers = (prior, std, std / prior, share, claimed)
            writer.writerow([method.estimation.name, name, *(repr(float(number)) for number in numbers)])
    return text.getvalue()


def _rows(method: MethodDetermination) -> list[tuple[str, np.float64, np.float64, np.float64, np.float64]]:
    found = method.found
    return list(zip(found.names, found.prior_std, found.posterior_std, found.prior_share, method.claimed, strict=True))
