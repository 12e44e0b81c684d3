"""What speaks against an identification by itself: an outcome that is none, a derivative of impossible sign or size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.estimate import Estimate, Outcome
from ident.statistics.contradictions import contradiction, shortfall
from scenarios.files.vehicles import VehicleFile
from scenarios.studies.rows import Row
from scenarios.terminal.numbers import number

# Models whose declared derivatives are knowledge; the ballistic coefficient of an unknown body is a mere start.
AIRCRAFT = ("rigid", "flexible", "loes", "lateral", "longitudinal")
FREE_OF_CHARGE = ("delay", "inv_tau")  # of a low-order system: started anywhere, zero included
CAUSES = "the model lacks something, a channel has a wrong sign or unit, or the file is wrong"


def cautions_of(vehicle: VehicleFile, estimate: Estimate, rows: Sequence[Row]) -> tuple[str, ...]:
    """Sentences, at most one on the outcome and one on all derivatives together."""
    told = []
    outcome = estimate.outcome
    if outcome is not Outcome.CONVERGED:
        told.append(f"{outcome.value}; {outcome.hint}" if outcome.hint else outcome.value)
    if vehicle.model in AIRCRAFT:
        told += [said] if (said := contradicted(rows, vehicle.derivatives)) else []
    return tuple(told)


def contradicted(rows: Sequence[Row], declared: Mapping[str, float]) -> str:
    """One sentence on all derivatives that the vehicle file contradicts by two sigmas, as too large, too small or of the other sign; or nothing."""
    found = []
    for row in rows:
        start = declared.get(row.name, 0.0)
        given = row.estimate, row.std, start
        why = "" if row.name in FREE_OF_CHARGE else contradiction(*given) or shortfall(*given)
        if why:
            found.append(f"{row.name} {number(row.estimate, row.std)} +- {number(row.std, row.std)} {why} (vehicle file {start:.4g})")
    return f"not to be believed: {'; '.join(found)}; {CAUSES}; flightid diagnose looks for the cause" if found else ""
