"""Each flight fitted with every set of the effects that recur, from which all flights together decide."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.files.documents import found_json
from scenarios.files.writing import write_json
from scenarios.survey.flights import Flight
from scenarios.survey.one_flight import FOLDER
from scenarios.tasks.work import Row, Task
from sim.errors import FlightidError

if TYPE_CHECKING:
    from ident.tracing.candidate_model.fitted_model import FitData, FittedModel
    from ident.whole_record.layout import FitSettings
    from sim.declaration.proposal import Traceable

SCHEMA = "flightid/survey-fits/2"
KEPT = "sets.json"
Starts = Mapping[str, float]  # by full name of a parameter


@dataclass(frozen=True)
class PooledFits:
    """The work: each task is a flight, fitted with all sets of ``effects`` beside the effects that are its own.

    ``starts``: where the search for an effect's parameters begins: what other flights found. ``own`` of each flight: its effects that belong to
    it alone, with their values.
    """

    flights: tuple[Flight, ...]
    effects: tuple[str, ...]
    starts: Starts
    own: tuple[Mapping[str, Starts], ...]
    folder: Path
    name: str = "flights fitted with what recurs"
    block: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        return {"flight": "text", "sets": "int"}

    def identity(self) -> Mapping[str, Any]:
        return {"digests": [self.digest(number) for number in range(len(self.flights))]}

    def digest(self, number: int) -> str:
        """Of everything that a flight's fits depend on; not of the starts, from which every fit goes to its end."""
        told = [SCHEMA, self.flights[number].digest, sorted(self.effects), sorted(self.own[number])]
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()

    def path(self, number: int) -> Path:
        return self.folder / FOLDER / self.flights[number].name / KEPT

    def kept(self, number: int) -> Mapping[str, Any] | None:
        """The fits of a flight as its folder has them; None where it has none of these."""
        content = found_json(self.path(number))
        return content if isinstance(content, dict) and content.get("digest") == self.digest(number) else None

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        out: list[Row | str] = []
        for task in tasks:
            try:
                sets = fitted_sets(self.flights[task.number], self.effects, self.starts, self.own[task.number])
            except FlightidError as error:
                out.append(str(error))
                continue
            write_json(self.path(task.number), {"schema": SCHEMA, "digest": self.digest(task.number), **sets})
            out.append({"flight": self.flights[task.number].name, "sets": len(sets["sets"])})
        return out


def fitted_sets(flight: Flight, names: Sequence[str], starts: Starts, own: Mapping[str, Starts]) -> dict[str, Any]:
    """Log likelihood, estimates and covariance of a flight's whole record with each set of the effects ``names`` that its model can have.

    Where a residual is coloured the likelihood counts fewer samples: it is scaled by the share that are independent, of the largest set.
    ``own`` effects are beside every set of ``sets``; beside those of ``sets_without`` only what belongs to a flight by nature, as a gust: a flight
    alone may have named one thing for two that recur.
    """
    from ident.statistics.residual_spectrum import effective_share
    from ident.tracing.candidate_model.fitted_model import FitData
    from ident.tracing.spikes.masks import measured_masks
    from ident.whole_record.layout import FitSettings
    from scenarios.diagnosis.candidates import candidates_for
    from scenarios.diagnosis.opening import opened_files, own_effects, posed_for, vehicle_path_of
    from scenarios.preparation.vehicle_model import step_for
    from scenarios.survey.candidates import is_of_flight

    request = flight.request()
    opened = opened_files(request, vehicle_path_of(request))
    posed = posed_for(opened, request.plan)
    records = (*posed.records, *posed.predicted)
    known = {each.name: each for each in candidates_for(posed.model, own_effects(request.effects, posed.model)[0])}
    outputs = [signal.name for signal in posed.model.equations.outputs if any(signal.name in record.output_names for record in records)]
    data = FitData(records, measured_masks(records, outputs), posed.model, outputs)
    settings = FitSettings(max_step=step_for(posed.model, posed.records, 0.01), enough=1e-6)
    able = [name for name in names if name in known]
    search = _Search(data, settings, known, starts, {full: value for each in own.values() for full, value in each.items()})
    beside = [name for name in own if name in known]
    remain = [name for name in beside if is_of_flight(name)]
    found = {True: search.sets(able, beside)} | ({False: search.sets(able, remain)} if remain != beside else {})
    most = next((each for each in reversed(found[True].values()) if each is not None), None)
    share = effective_share(most.fit.residuals, [problem.valid for problem in most.fit.layout.problems]) if most is not None else 1.0
    declared = [item.name for item in posed.model.parameters if item.free and not item.name.startswith("bias_")]
    units = {item.name: item.unit for item in posed.model.parameters}
    local = {name: [item.name for item in known[name].parameters if item.free] for name in able}
    return {
        "declared": declared,
        "units": {name: units[name] for name in declared},
        "effects": {name: {"parameters": local[name], "units": _units(known[name]), "full": _full(known[name])} for name in able},
        "independent": share,
        "own": [name for name in beside if name not in remain],
        **{
            key: {
                "+".join(sorted(taken)): _told(each, declared, [known[n] for n in sorted(taken)], share)
                for taken, each in found[own_in].items()
                if each
            }
            for key, own_in in (("sets", True), ("sets_without", False))
            if own_in in found
        },
    }


@dataclass(frozen=True, eq=False)
class _Search:
    """Fits of one record with sets of effects, each begun at the likeliest smaller one."""

    data: FitData
    settings: FitSettings
    known: Mapping[str, Traceable]
    starts: Starts
    own: Starts

    def sets(self, names: Sequence[str], beside: Sequence[str]) -> dict[frozenset[str], FittedModel | None]:
        """Every set of ``names``, with the effects ``beside`` in each; the whole one last."""
        found: dict[frozenset[str], FittedModel | None] = {}
        for size in range(len(names) + 1):
            for chosen in combinations(names, size):
                sound = [each for name in chosen if (each := found[frozenset(chosen) - {name}]) is not None]
                start = min(sound, key=lambda each: each.fit.cost, default=None)
                found[frozenset(chosen)] = self.fitted([*beside, *chosen], start)
        return found

    def fitted(self, names: Sequence[str], start: FittedModel | None) -> FittedModel | None:
        from ident.tracing.candidate_model.fitted_model import fit_set, start_from

        return fit_set(self.data, [self.known[name] for name in names], self.settings, start_from(start, {**self.own, **self.starts}))


def _units(effect: Traceable) -> dict[str, str]:
    return {item.name: item.unit for item in effect.parameters if item.free}


def _full(effect: Traceable) -> list[str]:
    from sim.declaration.effect import full_name

    return [full_name(effect, item.name) for item in effect.parameters if item.free]


def _told(fitted: FittedModel, declared: Sequence[str], effects: Sequence[Traceable], share: float) -> dict[str, Any]:
    """Estimates of the declared parameters and then of the effects', with their covariance."""
    from ident.statistics.information import inverse_information

    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    places = {name: at for at, name in enumerate(fitted.fit.layout.names)}
    names = [*declared, *(full for effect in effects for full in _full(effect))]
    at = [places.get(name, places.get(f"{name}, record 1", -1)) for name in names]
    sound = np.array([place >= 0 for place in at])
    chosen = np.array([max(place, 0) for place in at], dtype=int)
    estimate = np.where(sound, fitted.fit.theta[chosen], 0.0)
    return {
        "log_likelihood": share * fitted.fit.log_likelihood,
        "names": names,
        "estimate": estimate,
        "covariance": np.where(np.outer(sound, sound), covariance[np.ix_(chosen, chosen)], 1e30 * np.eye(len(at))) / share,
    }
