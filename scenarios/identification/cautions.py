"""What speaks against an identification by itself: an outcome that is none, a derivative of impossible sign or size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.filters.smoother import coloured_innovations
from ident.statistics.residuals import contradiction, shortfall
from ident.whole_record.output_error import UNDETERMINED, failed_simulation, none_determined
from scenarios.files.vehicles import VehicleFile
from scenarios.studies.rows import Row
from scenarios.terminal.numbers import number
from sim.record import Record

# Models whose declared derivatives are knowledge; the ballistic coefficient of an unknown body is a mere start.
AIRCRAFT = ("rigid", "flexible", "loes", "lateral", "longitudinal")
FREE_OF_CHARGE = ("delay", "inv_tau")  # of a low-order system: started anywhere, zero included
NOTABLE = 1.25  # times, by which coloured noise must widen a standard deviation to be worth a caution
STILL_SHORT = "10 % (in gusts 30 %)"  # what corrected standard deviations lack at most: docs/estimators.md, Coverage
CAUSES = "the model lacks something, a channel has a wrong sign or unit, or the file is wrong"


def cautions_of(vehicle: VehicleFile, estimate: Estimate, rows: Sequence[Row]) -> tuple[str, ...]:
    """Sentences, at most one on the outcome, one on coloured noise and one on all derivatives together."""
    told = []
    outcome = estimate.outcome
    if outcome is not Outcome.CONVERGED:
        told.append(f"{outcome.value}; {outcome.hint}" if outcome.hint else outcome.value)
    told += [said] if (said := coloured(estimate)) else []
    if vehicle.model in AIRCRAFT:
        told += [said] if (said := contradicted(rows, vehicle.derivatives)) else []
    return tuple(told)


def failed(records: Sequence[Record], estimate: Estimate, rows: Sequence[Row], declared: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence where an estimate by free simulation is none: it runs away, explains nothing, or determines no derivative."""
    measured, left = [], []
    for i, name in enumerate(estimate.output_names):
        of = [(record[name], row[i]) for record, row in zip(records, estimate.fitted, strict=False) if name in record.output_names]
        known = [(channel.values[channel.valid], row[channel.valid]) for channel, row in of if np.any(channel.valid)]
        measured.append(np.concatenate([z - np.mean(z) for z, _ in known] or [np.zeros(1)]))
        left.append(np.concatenate([z - y for z, y in known] or [np.zeros(1)]))
    units = {name: next(r[name].unit for r in records if name in r.output_names) for name in estimate.output_names}
    why = failed_simulation(units, measured, left) if len(estimate.fitted) == len(records) else ""
    if not why and none_determined((row.std, declared[row.name]) for row in rows if row.name in declared):
        why = UNDETERMINED
    remedy = "check units, signs and declared values, cut the record to single maneuvers, or use --method filter-error or equation-error"
    return (f"the fit has failed: {why}; {remedy}",) if why else ()


def coloured(estimate: Estimate) -> str:
    """One sentence on a filter whose innovations are coloured: by how much standard deviations for white noise are too small."""
    found = coloured_innovations(estimate)
    if found is None or not found.significant or not found.factor.size or found.factor.max() < NOTABLE:
        return ""
    worst = int(np.argmax(found.factor))
    apart = ", ".join(f"{name} {value:.2f}" for name, value in found.lag_one.items())
    text = f"the noise is not white (autocorrelation of the residuals one sample apart: {apart}): standard deviations for white noise "
    text += f"would be up to {found.factor[worst]:.1f} times too small ({found.names[worst]})"
    corrected = estimate.sigma(found.names[worst]) >= 0.99 * float(np.sqrt(found.covariance[worst, worst]))
    if not corrected:
        return text.replace("would be", "are") + "; those given are for white noise"
    return f"{text}; those given are corrected for it, and may still be up to {STILL_SHORT} too small, as the colour is known from this record alone"


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
