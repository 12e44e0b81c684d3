"""A surrogate flight is flown, its files are diagnosed, and the verdict is scored by the truth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from exam.scoring import same_fault
from exam.surrogates.declaration import Causes, Surrogate
from exam.surrogates.flights.flight import Flight, fly_surrogate, write_flight
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.preparation.plan import Request

Progress = Callable[[str, float], None]


class Naming(Enum):
    """Outcome for one hidden effect."""

    ALONE = "named"
    IN_GROUP = "named among the alternatives of a claim"
    MISSED = "not named"


@dataclass(frozen=True)
class Moved:
    """One derivative: nominal, before and after the search."""

    name: str
    nominal: float
    before: Quantity
    after: Quantity


@dataclass(frozen=True, eq=False)
class SurrogateStudy:
    """A surrogate flight that has been run.

    Attributes
    ----------
    named : by hidden effect, in order. false : claims that nothing true stands behind. small :
    claims of a small cause that does act,
        yet not as what dominates.
    held_out_ratio : error after over before by channel on data that were not fitted.
    """

    surrogate: Surrogate
    seed: int
    flight: Flight
    tracing: Tracing
    named: tuple[tuple[str, Naming], ...]
    false: tuple[str, ...]
    small: tuple[str, ...]
    derivatives: tuple[Moved, ...]
    held_out_ratio: dict[str, float]


def run_surrogate(
    surrogate: Surrogate, seed: int | None = None, progress: Progress = lambda stage, share: None
) -> SurrogateStudy:
    """Fly, diagnose from the files alone, and score.

    Raises
    ------
    FlightidError : the surrogate flight declares something that cannot be flown.
    """
    chosen = surrogate.seed if seed is None else seed
    progress("flying", 0.0)
    flight = fly_surrogate(surrogate, chosen)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        records, vehicle = write_flight(flight, Path(folder))
        tracing = diagnosed(records, vehicle, flight.drawn.axis.model, progress)
    return scored(surrogate, chosen, flight, tracing)


def diagnosed(
    records: Sequence[Path],
    vehicle: Path,
    model: str,
    progress: Progress = lambda stage, share: None,
) -> Tracing:
    """Diagnose all records of a flight: the last one is held out, the others are fitted
    together.
    """
    return diagnose_files(
        Request(tuple(records[:-1]), model, vehicle, tuple(records[-1:])), progress
    )


def scored(surrogate: Surrogate, seed: int, flight: Flight, tracing: Tracing) -> SurrogateStudy:
    """Score a diagnosis by the truth."""
    d = tracing.diagnosis
    claims = [claim for claim in d.effects if claim.claimed]
    hidden = [dominant.name for dominant in flight.drawn.hidden]
    named = tuple((name, naming(name, claims)) for name in hidden)
    extra = [
        claim.name
        for claim in claims
        if not any(naming(name, [claim]) is not Naming.MISSED for name in hidden)
    ]
    small = tuple(name for name in extra if acts(name, surrogate.causes))
    moved = tuple(
        Moved(name, flight.drawn.declared.parameters[name].value, d.before[name], d.after[name])
        for name in flight.drawn.starts
        if name in d.before and name in d.after
    )
    before, after = d.error_before.rmse, d.error_after.rmse
    ratio = {
        name: after[name] / before[name]
        for name in after
        if before.get(name, 0.0) > 0 and math.isfinite(after[name])
    }
    return SurrogateStudy(
        surrogate,
        seed,
        flight,
        tracing,
        named,
        tuple(name for name in extra if name not in small),
        small,
        moved,
        ratio,
    )


def naming(hidden: str, claims: Sequence[Claim]) -> Naming:
    """Return whether claims name a hidden effect; a lag and a delay of one sensor count as one
    name.
    """
    right = same_fault(hidden)
    if any(claim.name in right for claim in claims):
        return Naming.ALONE
    return (
        Naming.IN_GROUP
        if any(right & set(claim.alternatives) for claim in claims)
        else Naming.MISSED
    )


def acts(name: str, causes: Causes) -> bool:
    """Return whether an effect of the library is one of the small causes at these levels."""
    kind = name.partition("#")[0]
    return {
        "gust-turbulence": causes.turbulence > 0,
        "speed-variation": causes.speed_drift > 0 or causes.gravity > 0,
        "phugoid": causes.gravity > 0,
        "elastic-mode": causes.elastic > 0,
        "moment-nonlinearity": causes.moment_curvature > 0,
        "lift-nonlinearity": causes.lift_curvature > 0,
        "yaw-nonlinearity": causes.moment_curvature > 0,
        "side-force-nonlinearity": causes.lift_curvature > 0,
    }.get(kind, False)
