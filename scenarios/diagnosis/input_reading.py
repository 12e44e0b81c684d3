"""How inputs move between their samples, where nobody says it and what is found hangs on it.

A held input stands half an interval behind one that moves on. A time that is found (a delay, a lag)
is then another by half an interval as well. The loop takes the likelier reading; where neither is,
the standard deviations of what is found hold both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ident.tracing.diagnosis import TIMES, Data, Diagnosis, Quantity
from scenarios.diagnosis.opening import Opened, Posed, posed_for
from scenarios.preparation.declared_model import BETTER
from scenarios.preparation.plan import BY_HAND, Plan
from sim.declaration.model import Model
from sim.record import Hold, Record

CHOOSE = "--hold linear or --hold previous says which"
READ_AGAIN = "what was found is likelier so than with held ones; --hold previous holds them"


@dataclass(eq=False)
class InputReading:
    """The other reading of the inputs of a diagnosis: linear between samples, prepared when it is
    asked for.

    Attributes
    ----------
    opened, plan : the files, and how they are read. linear : what the loop is given with linear
        inputs, once it was asked for.
    """

    opened: Opened
    plan: Plan
    linear: Posed | None = field(default=None, init=False)

    @property
    def open(self) -> bool:
        """Whether nobody said how inputs are to be read between samples."""
        files = (*self.opened.records, *self.opened.validation)
        return self.plan.hold is None and not any(file.sidecar.says_hold for file in files)

    def posed(self) -> Posed:
        """What the loop is given with linear inputs."""
        if self.linear is None:
            self.linear = posed_for(self.opened, replace(self.plan, hold=Hold.LINEAR))
        return self.linear

    def offered(self, posed: Posed) -> Callable[[], Data] | None:
        """The records that are fitted and those that are predicted, with linear inputs, for the
        loop to ask for; None where inputs are linear already, or where somebody said how they move.
        """
        if not self.open or any(record.hold is not Hold.PREVIOUS for record in posed.records):
            return None

        def data() -> Data:
            linear = self.posed()
            return linear.records, linear.predicted

        return data

    def settled(
        self, posed: Posed, diagnosis: Diagnosis, looped: Callable[[Posed], Diagnosis]
    ) -> tuple[Posed, Diagnosis]:
        """The diagnosis with the reading that it rests on, and what the other one would change.

        Times that are found beside a model discrepancy are fitted to both readings here; the loop
        is run again where the other one is clearly likelier.
        """
        taken = any(each.record.hold is Hold.LINEAR for each in diagnosis.fitted)
        if self.linear is not None and taken:
            return replace(self.linear, notes=read_again(self.linear.notes)), diagnosis
        if not self.open or not tells_times(diagnosis, posed.records):
            return posed, diagnosis
        linear = self.posed()
        refit = refitted(diagnosis, posed.model, posed.records, linear.records)
        if refit.rise > BETTER:
            return replace(linear, notes=read_again(linear.notes)), looped(linear)
        diagnosis, told = left_open(refit, diagnosis)
        return replace(posed, notes=(*posed.notes, *told)), diagnosis


def tells_times(diagnosis: Diagnosis, records: Sequence[Record]) -> bool:
    """Whether times were found that held inputs would shift by half an interval."""
    if any(record.hold is not Hold.PREVIOUS for record in records):
        return False
    return any(name in TIMES for found in diagnosis.effects for name in found.parameters)


@dataclass(frozen=True)
class Refit:
    """What was found, fitted again with inputs that move linearly between samples.

    ``rise`` : by how much twice the log likelihood rises; minus infinity where nothing fits.
    ``values`` : parameters of the effects and of the declared model, by full name.
    """

    rise: float
    values: Mapping[str, float]


def refitted(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> Refit:
    """Fit what was found to both readings of the inputs."""
    from ident.tracing.candidate_model.fitted_model import FitData, Start, Values, fit_set

    found = diagnosis.trained_after
    if found is None:
        return Refit(-math.inf, {})
    fits = []
    for records in (held, linear):
        masks = [record.output_array(found.outputs)[1] for record in records]
        data = FitData(records, masks, model, found.outputs)
        start = Start(Values(found.shared, found.own, ()))
        fits.append(fit_set(data, found.effects, found.settings, start))
    first, second = fits
    if first is None or second is None or not math.isfinite(second.fit.cost):
        return Refit(-math.inf, {})
    return Refit(2.0 * (first.fit.cost - second.fit.cost), second.values.shared)


def left_open(again: Refit, first: Diagnosis) -> tuple[Diagnosis, tuple[str, ...]]:
    """What the second reading changes by more than a sigma, where it explains the records as well.

    Returns
    -------
    The diagnosis with standard deviations of both readings together: each is as probable as its
    likelihood says, and values stay those of the first. And what is told of it. Unchanged, and
    nothing, where one reading is clearly likelier.
    """
    if abs(again.rise) > BETTER:
        return first, ()
    share = 1.0 / (1.0 + math.exp(-0.5 * again.rise))
    moved: list[str] = []

    def widened(prefix: str, quantities: Mapping[str, Quantity]) -> dict[str, Quantity]:
        made = dict(quantities)
        for name, was in quantities.items():
            other = again.values.get(prefix + name, was.value)
            if abs(other - was.value) > was.std:
                moved.append(f"{prefix}{name} {other:.4g} for {was.value:.4g}")
            std = math.hypot(was.std, math.sqrt(share) * (other - was.value))
            made[name] = replace(was, std=std)
        return made

    effects = tuple(
        replace(found, parameters=widened(f"{found.name}.", found.parameters))
        for found in first.effects
    )
    after = widened("", first.after)
    if not moved:
        return first, ()
    note = (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(moved)}; standard deviations hold both: {CHOOSE}"
    )
    return replace(first, effects=effects, after=after), (note,)


def read_again(notes: Sequence[str]) -> tuple[str, ...]:
    """The sentences on a second reading, which no one chose by hand."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
