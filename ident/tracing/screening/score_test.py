"""Ranks all candidates at a fitted model by projected score: what each could explain that the
fitted model's own parameters cannot.

The residual and the candidates' signatures are whitened and projected off the fitted model's
Jacobian: a refit would absorb the rest. gain = -(N/2) ln(1 - explained share) (score test with
nuisance parameters projected out).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.background_task import BackgroundTask
from ident.estimate import counted_numerics
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, compiled_with
from ident.tracing.screening.alternative_outputs import BaseMotion, alternative_outputs, base_motion
from ident.tracing.screening.places import (
    WeighedPlaces,
    Whitened,
    added_by,
    closer_places,
    places_of,
    weigh,
    whitened,
)
from ident.tracing.screening.prominence import prominent_peaks
from ident.whole_record.layout import FitLayout
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.effect import Station, full_name
from sim.declaration.model import System
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to
from sim.errors import ModelError

Start = tuple[float, Mapping[str, float], WeighedPlaces]


@dataclass(frozen=True, eq=False)
class Finding:
    """A candidate's best places at a fitted model.

    ``gain`` of the log likelihood at the best; ``starts`` full name -> value, the best places
    first, the amplitudes as the projection has them; ``contribution`` what the best would add to
    the whitened, projected outputs, ``(D,)``.
    """

    effect: Traceable
    gain: float
    parameters: int
    starts: tuple[Mapping[str, float], ...]
    gains: tuple[float, ...]
    contribution: np.ndarray


def screen(
    fitted: FittedModel, candidates: Sequence[Traceable], context: SearchContext, most: int = 3
) -> list[Finding]:
    """Findings for all candidates that can act on the fitted model, the largest gain first.

    An effect whose signature is nothing, or points the unphysical way, is left out.
    """
    white, motions = whitened(fitted), _motions(fitted)
    effects = [
        fitted_to(candidate, context)
        for candidate in candidates
        if candidate.name not in fitted.names
    ]

    def found(places: Sequence[int]) -> dict[int, Finding]:
        findings = (
            (place, _find(fitted, white, motions, effects[place], context, most))
            for place in places
        )
        return {place: finding for place, finding in findings if finding is not None}

    places = range(len(effects))
    all_found = (
        found(places)
        if white.e.size * len(effects) < thresholds.WORTH_A_FORK
        else _in_two(found, effects)
    )
    return sorted(
        (all_found[place] for place in places if place in all_found),
        key=lambda finding: -finding.gain,
    )


def _in_two(
    found: Callable[[Sequence[int]], dict[int, Finding]], effects: Sequence[Traceable]
) -> dict[int, Finding]:
    """Every other candidate found by a fork of this process. What overflows there is told to
    whoever counts it here.
    """
    counter = np.geterrcall()

    def others() -> tuple[dict[int, tuple[Any, ...]], list[tuple[str, int]]]:
        told: list[tuple[str, int]] = []
        with (
            np.errstate(call=lambda kind, flag: told.append((kind, flag)))
            if callable(counter)
            else nullcontext()
        ):
            findings = found(range(1, len(effects), 2))
        # An effect of a user's own file does not go through a pipe; all else of a finding are
        # numbers.
        return {
            place: (one.gain, one.parameters, one.starts, one.gains, one.contribution)
            for place, one in findings.items()
        }, told

    beside = BackgroundTask(others)
    beside.begin()
    mine = found(range(0, len(effects), 2))
    theirs, told = beside.result()
    if callable(counter):
        for kind, flag in told:
            counter(kind, flag)
    return mine | {place: Finding(effects[place], *numbers) for place, numbers in theirs.items()}


def _motions(fitted: FittedModel) -> list[BaseMotion]:
    """What all candidates begin at, by record."""
    motions, layout = [], fitted.fit.layout
    for r, old in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        problem = _coarse(old, layout, fitted.system, p)
        assert problem.drive is not None
        motions.append(
            base_motion(
                problem, p, fitted.fit.lines[r].states, len(fitted.system.states), problem.drive
            )
        )
    return motions


def _coarse(old: RecordProblem, layout: FitLayout, system: System, p: np.ndarray) -> RecordProblem:
    """A record of the fit laid out for a system with the steps of a screening, its inputs as
    parameters ``p (np,)`` say.
    """
    return record_problem(
        old.record,
        system,
        max(layout.settings.max_step, thresholds.COARSE),
        (),
        (),
        valid=old.valid,
        at=p,
    )


def _find(
    fitted: FittedModel,
    white: Whitened,
    motions: Sequence[BaseMotion],
    effect: Traceable,
    context: SearchContext,
    most: int,
) -> Finding | None:
    probes = tuple(effect.probes(context))
    if not probes:
        return None
    try:
        signatures = _signatures(fitted, motions, effect, probes)
    except ModelError:
        return None
    apart, onset = belongs_to_record(effect) and len(white.rows) > 1, effect.traits.onset
    results: list[Start] = []
    spans = white.rows if apart else (slice(None),)
    for probe, parts in zip(probes, signatures, strict=True):
        tried = [weigh(fitted, parts, white, spans, places_of(fitted, probe, onset))]
        if probe.sharp:
            tried.append(weigh(fitted, parts, white, spans, closer_places(tried[0])))
        for weighed in tried:
            for place in np.argsort(-weighed.gains)[: 2 * most]:
                values = dict(probe.values)
                if probe.shifts:
                    values[onset] = values[onset] + weighed.places[place] * context.interval
                start = _start(effect, Probe(values, probe.slopes), weighed.amplitudes[place])
                if start is not None and weighed.gains[place] > 0:
                    results.append((float(weighed.gains[place]), start, weighed.at(int(place))))
    if not results:
        return None
    results.sort(key=lambda result: -result[0])
    results = _resonances_first(effect, results)
    distinct: list[tuple[float, Mapping[str, float], np.ndarray]] = []
    for gain, begun, here in results:
        added = added_by(white, here)
        if all(_differs(added, other[2]) for other in distinct):
            distinct.append((gain, begun, added))
        if len(distinct) == most:
            break
    count = sum(1 for item in effect.parameters if item.free) * (len(white.rows) if apart else 1)
    return Finding(
        effect,
        max(result[0] for result in distinct),
        count,
        tuple(r[1] for r in distinct),
        tuple(r[0] for r in distinct),
        distinct[0][2],
    )


def _resonances_first(effect: Traceable, results: list[Start]) -> list[Start]:
    """The places of an oscillation at which its gain stands out over the frequencies tried, the
    most prominent first, then all others.

    Where it hardly oscillates it promises what a delay or other derivatives would bring, at one
    frequency as at the next: a peak on such a plateau is hardly prominent. One that promises too
    little beside the best place is none.
    """
    if not effect.traits.oscillates:
        return results
    name = full_name(effect, effect.traits.oscillates[0])
    over = sorted(results, key=lambda result: result[1][name])
    peaks, _ = prominent_peaks(np.array([result[0] for result in over]))
    least = 0.2 * max(result[0] for result in results)
    first = [over[place] for place in peaks if over[place][0] >= least]
    known = {id(result) for result in first}
    return [*first, *(result for result in results if id(result) not in known)]


def _signatures(
    fitted: FittedModel, motions: Sequence[BaseMotion], effect: Traceable, probes: Sequence[Probe]
) -> list[list[np.ndarray]]:
    """For each probe the columns ``(m, N, k)`` of every record."""
    outputs = [signal.name for signal in fitted.system.outputs]
    _, system = compiled_with(fitted.model, [effect], outputs)
    layout = fitted.fit.layout
    columns, where = _alternatives(effect, probes, system.parameters.names)
    blocks: list[list[np.ndarray]] = [[] for _ in probes]
    for r, old in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        given = dict(zip(layout.system.parameters.names, p.tolist(), strict=True))
        base = np.array([given.get(item.name, item.value) for item in system.parameters])
        for local, value in effect.absent.items():
            base[system.parameters.index(full_name(effect, local))] = value
        alternatives = np.repeat(base[:, None], len(columns), axis=1)
        for column, values in enumerate(columns):
            for name, value in values.items():
                alternatives[system.parameters.index(name), column] = value
        problem = _coarse(old, layout, system, base)
        states = dict(zip(layout.system.state_names, fitted.fit.lines[r].states, strict=True))
        trajectory = np.array(
            [
                states[name] if name in states else np.zeros(len(old.grid.nodes))
                for name in system.state_names
            ]
        )
        # Where the fitted model's own input path meets another effect there, the input of the base
        # is worked out with it.
        motion = (
            None
            if layout.system.input_stages and effect.station is Station.INPUT_PATH
            else motions[r]
        )
        y, changed = alternative_outputs(
            problem, base, trajectory, alternatives, len(layout.system.states), motion
        )
        # a simulation that ran away has no signature: `weigh` leaves it out
        with counted_numerics():
            for number, (first, count, reference, step) in enumerate(where):
                zero = y[:, :, None] if reference < 0 else changed[:, :, reference : reference + 1]
                blocks[number].append((changed[:, :, first : first + count] - zero) / step)
    return blocks


def _alternatives(
    effect: Traceable, probes: Sequence[Probe], names: Sequence[str]
) -> tuple[list[dict[str, float]], list[tuple[int, int, int, np.ndarray]]]:
    """Parameter values of every column, and for each probe: its first column, their number, the
    reference's column (-1: the base), steps.
    """
    size = {item.name: abs(item.value) or 1.0 for item in effect.parameters}
    columns: list[dict[str, float]] = []
    where = []
    for probe in probes:
        full = {full_name(effect, local): value for local, value in probe.values.items()}
        if not probe.slopes:
            where.append((len(columns), 1, -1, np.ones(1)))
            columns.append(full)
            continue
        reference = -1
        if any(probe.values.get(local) != value for local, value in effect.absent.items()):
            reference = len(columns)
            columns.append(full)
        steps = np.array([thresholds.SLOPE_STEP * size[local] for local in probe.slopes])
        where.append((len(columns), len(steps), reference, steps))
        columns += [
            {**full, full_name(effect, local): probe.values[local] + step}
            for local, step in zip(probe.slopes, steps.tolist(), strict=True)
        ]
    return columns, where


def _start(effect: Traceable, probe: Probe, amplitudes: np.ndarray) -> dict[str, float] | None:
    """Where a full fit begins; None where the projection points the unphysical way."""
    bounds = {item.name: item.bounds for item in effect.parameters}
    values = dict(probe.values)
    if not probe.slopes and amplitudes[0] <= 0.0:
        return None
    for local, amplitude in zip(probe.slopes, amplitudes.tolist(), strict=False):
        low, high = bounds[local]
        moved = values[local] + amplitude
        if (
            len(probe.slopes) == 1
            and (moved < low or moved > high)
            and not low < values[local] < high
            and (amplitude < 0) == (values[local] <= low)
        ):
            return None
        values[local] = float(np.clip(moved, low, high))
    return {
        full_name(effect, local): float(np.clip(value, *bounds[local]))
        for local, value in values.items()
    }


def _differs(a: np.ndarray, b: np.ndarray) -> bool:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return bool(size > 0 and abs(a @ b) < thresholds.DISTINCT * size)
