"""Long records that are almost all cruise."""

from __future__ import annotations

from collections.abc import Sequence

from ident.maneuver_detection import AXES, FlightSignals, active_share
from sim.record import Record

LONG = 120.0  # s, of all records together; a shorter one is a maneuver with its rest
# Share of the time with moving inputs, below which a record is called almost all cruise. Of 40 simulated flights of 20 minutes
# with a maneuver every one to two minutes, which move for 0.27 to 0.72 of their time, none is; nor is a measured one.
CRUISE = 0.1


def cruise_caution(records: Sequence[Record], name: str, opening: Sequence[str] = ()) -> str:
    """One sentence where long records are almost all cruise: the share of their time in which an input moves; empty elsewhere.

    ``name`` : of the first file, for the command that finds the maneuvers in it; ``opening`` : the
    options that open it.
    """
    signals = [FlightSignals(each.time, {one.name: one.values for one in each.inputs if one.name in AXES}, {}) for each in records]
    spans = [float(each.time[-1] - each.time[0]) for each in records]
    if sum(spans) < LONG or not any(each.inputs for each in signals):
        return ""
    share = sum(span * active_share(each) for span, each in zip(spans, signals, strict=True)) / sum(spans)
    if share >= CRUISE:
        return ""
    moved = f"an input moves beyond its noise in {100.0 * share:.1f} % of {sum(spans):.0f} s: the record is almost all cruise"
    return f"{moved}; flightid maneuvers {' '.join([name, *opening])} --out DIR finds its maneuvers, and --maneuver N uses one of them"
