"""Records that no fit of model `aircraft` should start from: angles in degrees, accelerations in
other units, surfaces that move together.

A file without units is read as SI. Numbers that no aircraft flies tell that it was not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from math import pi

import numpy as np

from ident.recording.kinematic_relations import LENGTHS
from scenarios.preparation.drafting import NEVER
from sim.aerodynamics import Term
from sim.declaration.model import Model
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Channel, Record
from sim.vehicles.aircraft import Aircraft, declaration_of

# Bank is told from -pi to pi. A heading may count turns.
LARGEST = {
    **dict.fromkeys(("alpha", "beta", "theta"), NEVER["rad"]),
    "phi": 1.01 * pi,
    **dict.fromkeys(("p", "q", "r"), NEVER["rad/s"]),
}
COMMON = 97.0  # percentile that has to exceed a limit: single wrong samples say nothing of the unit
# Median specific force of a flight, m/s2: one g unless most of the record is a turn or a dive.
IN_G, IN_FEET = (0.7, 1.6), (0.9 * G0 / LENGTHS["ft"], 1.1 * G0 / LENGTHS["ft"])
TOGETHER = 1e-6  # of a surface's motion, that another does not share: recorded surfaces have noise


def refuse_unfit_records(records: Sequence[Record], model: Model) -> None:
    """Nothing where records may be fitted by a model, or it is no aircraft of terms.

    Parameters
    ----------
    records : of one call, SI. model : with its free parameters.

    Raises
    ------
    RecordError : angles or accelerations that are in another unit than they are said to be; two
    surfaces that move together in all records although both have free terms in one coefficient.
    """
    aircraft = declaration_of(model)
    if aircraft is None:
        return
    refuse_other_units(records, aircraft)
    free = {item.name for item in model.parameters if item.free}
    used: dict[str, set[str]] = {}
    for name, (axis, term) in aircraft.terms.items():
        if name in free:
            used.setdefault(axis, set()).update(_surfaces_of(term, aircraft))
    refuse_moving_together(records, aircraft, list(used.values()))


def refuse_other_units(records: Sequence[Record], aircraft: Aircraft) -> None:
    """Raise RecordError for angles in degrees, accelerations in g or ft/s2 that are read as SI."""
    deflections = [name for name, unit in aircraft.surfaces.items() if unit == "rad"]
    limits = {**dict.fromkeys(deflections, NEVER["rad"]), **LARGEST}
    for record in records:
        for channel in record.channels:
            limit = limits.get(channel.name)
            common = _common(channel) if limit is not None else 0.0
            if limit is not None and common > limit:
                rate = "/s" if channel.name in ("p", "q", "r") else ""
                raise RecordError(
                    f"samples are beyond {common:.3g} rad{rate}, which no aircraft "
                    "does: the column is in degrees",
                    where=f"{record.name}, channel {channel.name}",
                    remedy=f"name its unit in the header, as in {channel.name}_deg, or in a "
                    "channel map",
                )
        _refuse_accelerations(record)


def _refuse_accelerations(record: Record) -> None:
    if "az" not in record.output_names:
        return
    values = record["az"].values[record["az"].valid]
    felt = float(np.median(np.abs(values))) if len(values) else G0
    for unit, (low, high) in (("g", IN_G), ("ft/s2", IN_FEET)):
        if low < felt < high:
            raise RecordError(
                f"its median is {felt:.3g} m/s2 where the lift of level flight is 9.81 m/s2: the "
                f"column is in {unit}",
                where=f"{record.name}, channel az",
                remedy="give its unit in a channel map",
            )


def refuse_moving_together(
    records: Sequence[Record], aircraft: Aircraft, groups: Sequence[Collection[str]]
) -> None:
    """Raise RecordError for two surfaces of one group that are one another's multiple.

    Parameters
    ----------
    records : of one call. groups : signals of terms, surfaces or mixes, whose effects are to be
        told apart.
    """
    rows = surface_motion(records, aircraft)
    told = {tuple(sorted(pair)) for group in groups for pair in combinations(sorted(group), 2)}
    for one, other in sorted(told):
        if one not in rows or other not in rows:
            continue
        a, b = rows[one], rows[other]
        shared = float(a @ b) / float(a @ a) if np.any(a) else 0.0
        if (
            np.any(a)
            and np.any(b)
            and np.linalg.norm(b - shared * a) < TOGETHER * np.linalg.norm(b)
        ):
            raise RecordError(
                f"{one} and {other} move together in all records: no fit tells their effects apart",
                where=", ".join(dict.fromkeys(record.name for record in records)),
                remedy="move one after the other, declare one mix of both, or hold the terms of "
                "one under fixed",
            )


def commanded(aircraft: Aircraft) -> tuple[str, ...]:
    """Surfaces and mixes whose effects a user wants apart: parts of a mix stand in the mix.

    Parameters
    ----------
    aircraft : what declares them.
    """
    mixed = {part for parts in aircraft.mixes.values() for part in parts}
    return tuple(name for name in (*aircraft.surfaces, *aircraft.mixes) if name not in mixed)


def surface_motion(records: Sequence[Record], aircraft: Aircraft) -> Mapping[str, np.ndarray]:
    """Surfaces and mixes of all records about their means, ``(N,)`` each, where they are recorded.

    Parameters
    ----------
    records : of one call. aircraft : what declares surfaces and mixes.
    """
    parts: dict[str, list[np.ndarray]] = {}
    for record in records:
        here = {
            name: record[name].values for name in aircraft.surfaces if name in record.input_names
        }
        for name, mix in aircraft.mixes.items():
            if all(part in here for part in mix):
                total = sum(factor * here[part] for part, factor in mix.items())
                here[name] = np.asarray(total)
        for name, row in here.items():
            parts.setdefault(name, []).append(row - np.mean(row))
    whole = len(records)
    return {name: np.concatenate(rows) for name, rows in parts.items() if len(rows) == whole}


def _surfaces_of(term: Term, aircraft: Aircraft) -> set[str]:
    """The surface or mix that stands alone in a term; products with the air's angles differ."""
    names = term.signals & {*aircraft.surfaces, *aircraft.mixes}
    return set(names) if len(term.factors) == 1 and term.factors[0].power == 1 else set()


def _common(channel: Channel) -> float:
    values = np.abs(channel.values[channel.valid])
    return float(np.percentile(values, COMMON)) if len(values) else 0.0
