"""Flights with one hidden effect each, as tasks. A row has the hidden effect, the conclusion of the
loop, and the errors of its numbers.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from time import process_time

from exam.every_effect.carriers import Instance, chosen, effect_of
from exam.every_effect.flight import Flown, fly_hidden, write_hidden
from exam.scores.scored_flight import (
    Outcome,
    ScoredFlight,
    Stated,
    claims_of,
    outcome_of,
    over_noise,
    parameter_errors,
    plain_name,
    stated_by,
)
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.tasks.work import Cell, Row, RowTable, Task
from sim.declaration.proposal import RangedCurve

TAKEN = "diagnosis_seconds"  # processor time
COLUMNS = {
    **{
        "effect": "text",
        "planted": "text",
        "vehicle": "text",
        "model": "text",
        "size_sigmas": "float",
        "values": "text",
    },
    **{
        "verdict": "text",
        "outcome": "text",
        "right": "bool",
        "name": "text",
        "false": "text",
        "probability": "float",
        "stated": "text",
    },
    **{
        "error_sigmas": "float",
        "errors": "text",
        "derivatives": "text",
        "held_out_before": "float",
        "held_out_after": "float",
    },
    TAKEN: "time",
}


@dataclass(frozen=True)
class HiddenEffectFlight:
    """One flight of the campaign.

    It has the number and seed of its task, the ``effect`` for which it was flown, the ``hidden``
    effect (empty if nothing is hidden) with local ``values`` in SI and its ``size`` in sigmas, the
    score, and the errors of the declared ``derivatives`` in reported sigmas.
    """

    number: int
    seed: int
    effect: str
    hidden: str
    vehicle: str
    model: str
    size: float
    values: Mapping[str, float]
    marked: ScoredFlight
    derivatives: Mapping[str, float]
    seconds: float


@dataclass(frozen=True)
class EveryEffect:
    """The campaign: in each turn one flight for each of some ``effects``, None for all of the
    library.

    Flight k has effect ``k mod n`` of n. A campaign with more flights for each effect therefore
    begins with the same flights.
    """

    effects: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        return "every-effect"

    @property
    def columns(self) -> Mapping[str, str]:
        return COLUMNS

    @property
    def block(self) -> int:
        return 1

    @cached_property
    def kinds(self) -> Mapping[str, tuple[Instance, ...]]:
        """Names of the hidden effects. Raises DeclarationError for an effect that the library
        lacks.
        """
        return chosen(self.effects)

    def identity(self) -> Mapping[str, object]:
        return {
            "campaign": self.name,
            "effects": {
                name: [f"{each.model} {each.name}" for each in found]
                for name, found in self.kinds.items()
            },
        }

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        return [self._row(task) for task in tasks]

    def fly(self, task: Task) -> Flown:
        """Fly the flight of a task."""
        names = tuple(self.kinds)
        return fly_hidden(
            self.kinds[names[task.number % len(names)]], task.number // len(names), task.seed
        )

    def read(self, table: RowTable) -> list[HiddenEffectFlight]:
        """Return the flights of a table that have a row, in order."""
        return [_read(table, at) for at in range(len(table)) if not table.columns["error"][at]]

    def _row(self, task: Task) -> Row:
        flown = self.fly(task)
        with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
            request = write_hidden(flown, Path(folder))
            started = process_time()
            tracing = diagnose_files(request)
            taken = process_time() - started
        marked, names = scored_flight_of(flown, tracing), tuple(self.kinds)
        errors = [*marked.errors.values()]
        first = next((each for each in marked.stated if each.first), None)
        row: dict[str, Cell] = {
            "effect": names[task.number % len(names)],
            "planted": flown.name,
            "vehicle": flown.carrier.vehicle,
            "model": flown.carrier.model,
            "size_sigmas": flown.size,
            "values": json.dumps(dict(flown.values)),
            "verdict": marked.verdict,
            "outcome": marked.outcome.value,
            "right": marked.right,
            "name": " + ".join(marked.given),
            "false": " + ".join(marked.false),
            "probability": first.probability if first else None,
            "stated": json.dumps([asdict(each) for each in marked.stated]),
            "error_sigmas": max(errors, key=abs) if errors else None,
            "errors": json.dumps(dict(marked.errors)),
            "derivatives": json.dumps(derivative_errors(flown, tracing)),
            "held_out_before": marked.held_out_before,
            "held_out_after": marked.held_out_after,
            TAKEN: taken,
        }
        return row


def scored_flight_of(flown: Flown, tracing: Tracing) -> ScoredFlight:
    """Score a diagnosis by the hidden effect."""
    d, claims = tracing.diagnosis, claims_of(tracing.diagnosis)
    right = right_names(flown)
    false = tuple(
        claim.name
        for claim in claims
        if not right & {plain_name(name) for name in (claim.name, *claim.alternatives)}
    )
    outcome = outcome_of(d.verdict.value, claims)
    named = bool(claims) and outcome in (Outcome.NAMED, Outcome.AMBIGUOUS)
    noise = flown.carrier.noise
    return ScoredFlight(
        (flown.name,) if flown.name else (),
        d.verdict.value,
        outcome,
        tuple(claim.name for claim in claims),
        named and not false if flown.name else outcome is Outcome.NOTHING,
        false,
        stated_by(claims, right),
        parameter_errors(claims, {flown.name: _comparable(flown)}),
        over_noise(d.error_before, noise),
        over_noise(d.error_after, noise),
    )


def right_names(flown: Flown) -> frozenset[str]:
    """Return the names that count as right.

    They are the name of the effect, names of the same fault, and the name of another effect that
    equals it at this size.
    """
    if not flown.name:
        return frozenset()
    traits = effect_of(Instance(flown.carrier.model, flown.name)).traits
    same = {
        other
        for local, (other, least) in traits.same_as.items()
        if abs(flown.values[local]) > least
    }
    return frozenset(plain_name(name) for name in {flown.name, *traits.twins, *same})


def derivative_errors(flown: Flown, tracing: Tracing) -> dict[str, float]:
    """Return the errors of the declared parameters, with the claims, in reported sigmas."""
    true, after = flown.carrier.train.model.parameters, tracing.diagnosis.after
    errors = {
        name: (after[name].value - true[name].value) / after[name].std
        for name in flown.carrier.free
        if name in after and after[name].std > 0.0
    }
    return {name: float(error) for name, error in errors.items() if math.isfinite(error)}


def _comparable(flown: Flown) -> Mapping[str, float]:
    """Return the true values that a diagnosis may estimate.

    Coefficients of curves are left out, because they depend on the range that the search saw.
    """
    return (
        {}
        if not flown.name
        or isinstance(effect_of(Instance(flown.carrier.model, flown.name)), RangedCurve)
        else flown.values
    )


def _read(table: RowTable, at: int) -> HiddenEffectFlight:
    def cell(name: str) -> str:
        return str(table.columns[name][at])

    def number(name: str) -> float:
        return float(table.columns[name][at])

    hidden = cell("planted")
    stated = tuple(Stated(**each) for each in json.loads(cell("stated")))
    given, false = (tuple(filter(None, cell(column).split(" + "))) for column in ("name", "false"))
    marked = ScoredFlight(
        (hidden,) if hidden else (),
        cell("verdict"),
        Outcome(cell("outcome")),
        given,
        bool(table.columns["right"][at]),
        false,
        stated,
        json.loads(cell("errors")),
        number("held_out_before"),
        number("held_out_after"),
    )
    sizes = number("size_sigmas"), json.loads(cell("values"))
    own = (
        int(table.columns["number"][at]),
        int(table.columns["seed"][at]),
        cell("effect"),
        hidden,
        cell("vehicle"),
        cell("model"),
    )
    return HiddenEffectFlight(
        *own, *sizes, marked, json.loads(cell("derivatives")), float(table.times[TAKEN][at])
    )
