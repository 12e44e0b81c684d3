"""The maneuver that would decide where a diagnosis could not: designed for the effects that these
records cannot tell apart, as they were fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from scenarios.files.sources import Source
from scenarios.files.user_models import OwnModel
from scenarios.files.vehicles import VehicleFile
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.limits import PILOT
from scenarios.maneuver_design.setting import DesignRequest
from scenarios.preparation.plan import Request
from sim.declaration.model import Model
from sim.declaration.proposal import Curve, Traceable
from sim.effects.library import effects_for
from sim.errors import FlightidError
from sim.record import Record

DIGITS = 4  # of every number that is asked: what is printed is what was designed with
# s of a flight: with less there is no room, with more a design could take longer than the diagnosis
SHORTEST, LONGEST = 10.0, 20.0
SMALLER = 2.0  # a hand is quicker, in peaks a second, where it does not go to the full deflection


def deciding_maneuver(
    d: Diagnosis, request: Request, vehicle: VehicleFile, model: Model, records: Sequence[Record]
) -> DesignResult | None:
    """The design for an ambiguous diagnosis; None for any other, and where nothing can be designed
    for these effects.

    Peak deflections, sampling and noise are those of the records, derivatives and sizes those that
    were found.
    """
    asked = _asked(d, request, vehicle, model, records) if d.verdict is Verdict.AMBIGUOUS else None
    if asked is None:
        return None
    try:
        return design(asked)
    except FlightidError:
        return None  # as a law of the user's own, or a model without an input


def _asked(
    d: Diagnosis, request: Request, vehicle: VehicleFile, model: Model, records: Sequence[Record]
) -> DesignRequest | None:
    doubtful = [claim for claim in d.effects if claim.claimed and claim.alternatives]
    known = {
        effect.name: effect
        for effect in effects_for(model.equations)
        if isinstance(effect, Traceable)
    }
    if not doubtful or not model.equations.inputs:
        return None
    claim = doubtful[0]
    # What no record tells apart no flight decides, and one rival is what there is time for: the
    # plainest, of which others are wider forms.
    rivals = (
        [
            name
            for name in claim.alternatives
            if name in known and name not in known[claim.name].traits.equivalents
        ]
        if claim.name in known
        else []
    )
    if not rivals:
        return None
    names = (claim.name, min(rivals, key=lambda name: len(known[name].parameters)))
    values = [
        _text(name, q.value) for name, q in d.after.items() if name in model.parameters.free_names
    ]
    noise = [_text(name, std) for name, std in d.residual_std.items() if std > 0.0]
    interval = float(np.median(np.diff(records[0].time)))
    span = min(
        LONGEST, max(SHORTEST, float(max(record.time[-1] - record.time[0] for record in records)))
    )
    return DesignRequest(
        model=request.model,
        vehicle=_source(request, vehicle),
        tell=names,
        size=",".join(_size(claim, d)),
        values=tuple(values),
        noise=tuple(noise),
        amplitude=tuple(
            _text(name, size) for name, size in _peaks(model, records).items() if size > 0.0
        ),
        duration=float(f"{span:.{DIGITS}g}"),
        rate=float(f"{1.0 / interval:.{DIGITS}g}"),
        computer=not by_hand(model, records),
        command_names=_names(request, vehicle),
    )


def by_hand(model: Model, records: Sequence[Record]) -> bool:
    """Whether no input of the records changes faster than a pilot's hand can; faster inputs are
    from a flight computer, which can fly the next maneuver as well.
    """
    peaks = _peaks(model, records)
    return all(
        float(np.max(np.abs(np.diff(record[name].values)) / np.diff(record.time)))
        <= SMALLER * peak / PILOT.rise
        for record in records
        for name, peak in peaks.items()
        if name in record.input_names and len(record.time) > 1
    )


def _text(name: str, value: float) -> str:
    return f"{name}={value:.{DIGITS}g}"


def _size(claim: Claim, d: Diagnosis) -> list[str]:
    """The claimed effect's own parameters, and of a curve the range that it was fitted over."""
    effects: Sequence[Traceable] = d.trained_after.effects if d.trained_after is not None else ()
    form = next((effect for effect in effects if effect.name == claim.name), None)
    own = {item.name for item in form.parameters} if form is not None else set()
    texts = [_text(name, q.value) for name, q in claim.parameters.items() if name in own]
    return texts + (
        [_text("low", form.low), _text("high", form.high)] if isinstance(form, Curve) else []
    )


def _peaks(model: Model, records: Sequence[Record]) -> dict[str, float]:
    """Largest deflection of each input from where its record begins."""
    names = [signal.name for signal in model.equations.inputs]
    return {
        name: max(
            float(np.max(np.abs(record[name].values - record[name].values[0])))
            for record in records
            if name in record.input_names
        )
        for name in names
        if any(name in record.input_names for record in records)
    }


def _source(request: Request, vehicle: VehicleFile) -> Source | None:
    """The vehicle file as it was read; None where an own model went without one."""
    from scenarios.diagnosis.opening import vehicle_path_of

    path = vehicle_path_of(request)
    if path is None or isinstance(path, Source):
        return path
    assert vehicle.identity is not None
    return Source(path, vehicle.text.encode(), vehicle.identity)


def _names(request: Request, vehicle: VehicleFile) -> Mapping[str, str]:
    """What stands for the files on a command line."""
    from scenarios.diagnosis.opening import vehicle_path_of

    path = vehicle_path_of(request)
    shown = "" if path is None else str(path.path if isinstance(path, Source) else path)
    own = (
        vehicle.own_file.name
        if isinstance(request.model, OwnModel) and vehicle.own_file is not None
        else str(request.model)
    )
    return {"model": own, "vehicle": shown}
