"""One meaning of every sigma of a diagnosis: that of the fit, and never below what the scatter between records leaves of a mean."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from ident.tracing.diagnosis import Claim, Diagnosis, Quantity

NOTE = "+- sigma, at least the scatter between records (run-to-run over the root of their number)"


def with_scatter(d: Diagnosis) -> Diagnosis:
    """The diagnosis with sigmas of the derivatives before, and under each member of a group, that hold the scatter between records.

    Those after hold it already; a diagnosis without a scatter comes back itself.
    """
    if not d.scatter:
        return d
    return replace(d, before=_at_least(d.before, d.scatter, len(d.fitted)), effects=tuple(_claim(claim, d.scatter) for claim in d.effects))


def _claim(claim: Claim, scatter: Mapping[str, float]) -> Claim:
    evidence = claim.evidence
    if evidence is None:
        return claim
    members = {name: _at_least(some, scatter, len(evidence.by_record)) for name, some in evidence.derivatives.items()}
    return replace(claim, evidence=replace(evidence, derivatives=members))


def _at_least(some: Mapping[str, Quantity], scatter: Mapping[str, float], records: int) -> dict[str, Quantity]:
    share = 1.0 / math.sqrt(max(1, records))
    return {name: replace(q, std=max(q.std, scatter.get(name, 0.0) * share)) for name, q in some.items()}
