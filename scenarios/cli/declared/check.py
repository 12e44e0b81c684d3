"""`flightid check`."""

from __future__ import annotations

from scenarios.cli.options import (
    AsJson,
    Channels,
    Columns,
    Figures,
    From,
    Held,
    Lowpass,
    ManeuverFile,
    Maneuvers,
    NoFigures,
    Out,
    Quiet,
    Rate,
    Records,
    To,
    Trust,
    VehicleBeside,
)
from scenarios.plots.formats import formats_of
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import plan_of
from scenarios.preparation.request import Request


def check(
    records: Records,
    vehicle: VehicleBeside = None,
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    trust: Trust = False,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Data compatibility: what the kinematics alone say of the sensors."""
    from scenarios.cli.telling import telling
    from scenarios.commands.check import check_records

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust, columns=columns)
    plan = with_maneuvers(plan, records, maneuver, maneuvers)
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["compatibility.json"]) as told:
        check_records(Request(tuple(records), vehicle=vehicle, channels=channels, plan=plan), told.out, told.figures)
