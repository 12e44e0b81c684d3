"""What a user asks of the preparation: which parts of a record, how its inputs are to be read, which filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:  # a record loads NumPy, and a process that draws figures starts before that
    from sim.record import Hold


SPEED, DENSITY, LIFT, ATTITUDE = "airspeed_change", "density_change", "lift", "theta"
MEASURED_MOTION = (SPEED, DENSITY, LIFT, ATTITUDE)  # inputs of the equations that are measured motion: no control, which alone excites
BY_HAND = "chosen by hand"  # of a hold, in the sentences on how records were prepared


@dataclass(frozen=True)
class Segment:
    """A part of a record, both ends included, s; None leaves that end open."""

    start: float | None = None
    stop: float | None = None


WHOLE = (Segment(),)


@dataclass(frozen=True)
class Plan:
    """How records are prepared; the same for all of a call.

    Attributes
    ----------
    segments : each becomes a record of its own.
    hold : behaviour of the inputs between samples; None: as the file's sidecar says, else as the data say.
    rate : Hz, to which all channels are resampled behind one anti-alias filter; None keeps the samples. Of a file without a clock it is the
        rate of its rows, and of a log of several topics the rate of the grid that they are put on.
    lowpass : Hz, corner of one zero-phase filter for all channels; None leaves them unfiltered.
    columns : names of a file's columns, in their order, where it has no header or another one is wanted; none keeps its own.
    trusted : what the raw columns show is only warned of; nothing is refused or set aside for it.
    chosen : sentences on where the segments come from, where a file of maneuvers gave them.
    """

    segments: tuple[Segment, ...] = WHOLE
    hold: Hold | None = None
    rate: float | None = None
    lowpass: float | None = None
    trusted: bool = False
    columns: tuple[str, ...] = ()
    chosen: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        for option, value in (("--rate", self.rate), ("--lowpass", self.lowpass)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise DeclarationError(f"{value:g} Hz is no frequency", where=option, remedy="give a number above zero")


def refuse_turned(start: float | None, stop: float | None, where: str) -> None:
    """Raise DeclarationError where a part of a record, as a file declares it, ends before it
    begins."""
    if start is not None and stop is not None and not start < stop:
        raise DeclarationError(f"from = {start:g} is not before to = {stop:g}", where=where, remedy="give the earlier time first")


def plan_of(
    starts: Sequence[float] | None = None,
    stops: Sequence[float] | None = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    *,
    trusted: bool = False,
    columns: str | None = None,
) -> Plan:
    """A plan from the words of a command line: ``--from`` and ``--to`` in pairs, in their order.

    Raises
    ------
    DeclarationError : ends that make no pairs, segments that overlap, a hold or a frequency that is none, an empty or repeated name.
    """
    held = _hold_of(hold) if hold is not None else None
    return Plan(_segments(list(starts or ()), list(stops or ())), held, rate, lowpass, trusted, _names_of(columns))


def options_of(plan: Plan) -> list[str]:
    """The words of a command line that ask for a plan; segments of maneuvers as their times."""
    words = []
    for segment in plan.segments:
        for option, value in (("--from", segment.start), ("--to", segment.stop)):
            words += [option, f"{value:.9g}"] if value is not None else []
    words += ["--hold", plan.hold.value] if plan.hold is not None else []
    for option, frequency in (("--rate", plan.rate), ("--lowpass", plan.lowpass)):
        words += [option, f"{frequency:.9g}"] if frequency is not None else []
    words += ["--columns", ",".join(plan.columns)] if plan.columns else []
    return [*words, "--trust-record"] if plan.trusted else words


def _names_of(columns: str | None) -> tuple[str, ...]:
    names = tuple(name.strip() for name in columns.split(",")) if columns is not None else ()
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None or not all(names):
        what = f"{twice!r} is named twice" if twice else "a name is empty"
        raise DeclarationError(what, where="--columns", remedy="give one name a column, as in time,elevator,alpha,q")
    return names


def _hold_of(word: str) -> Hold:
    from sim.record import Hold

    kinds = {kind.value: kind for kind in Hold}
    if word not in kinds:
        raise DeclarationError(f"there is no hold {word!r}", where="--hold", remedy=f"use {' or '.join(kinds)}")
    return kinds[word]


def _segments(starts: list[float], stops: list[float]) -> tuple[Segment, ...]:
    if len(starts) <= 1 and len(stops) <= 1:
        return (Segment(starts[0] if starts else None, stops[0] if stops else None),)
    if len(starts) != len(stops):
        what = f"{len(starts)} times --from and {len(stops)} times --to"
        raise DeclarationError(what, where="--from, --to", remedy="give each segment both ends, in pairs")
    for start, stop in zip(starts, stops, strict=True):
        if not start < stop:
            raise DeclarationError(f"--from {start:g} is not before --to {stop:g}", where="--from, --to", remedy="give the earlier time first")
    ordered = sorted(zip(starts, stops, strict=True))
    for (start, stop), (later, end) in pairwise(ordered):
        if later < stop:
            what = f"the segments {start:g} to {stop:g} s and {later:g} to {end:g} s overlap"
            raise DeclarationError(what, where="--from, --to", remedy="let no sample count twice")
    return tuple(Segment(start, stop) for start, stop in zip(starts, stops, strict=True))
