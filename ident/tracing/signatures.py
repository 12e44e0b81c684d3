"""Signatures: changes of the outputs of a fitted model by a candidate at values of its
parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.estimate import counted_numerics
from ident.tracing.fitted_model import FittedModel, compiled_with
from ident.tracing.priors import prior_of
from ident.whole_record.alternatives import BaseMotion, alternative_outputs, base_motion
from ident.whole_record.layout import FitLayout
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.effect import NoiseEffect, Station, full_name
from sim.declaration.model import System
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to
from sim.errors import ModelError

PLACED_SIZE_SHARE = 0.4  # one sigma of the size of a placed event, relative to the size
LARGEST_SIGNATURE = 1e6  # largest signature; the simulation of a larger one diverged
SLOPE_STEP = 1e-4  # step of differences, relative to a parameter's declared size
COARSE_STEP = 0.025  # s, sub-step that is accurate enough to rank candidates


# An effect with its probes and the signatures of each, ``(m, N, k)`` a record.
CandidateSignatures = tuple[Traceable, Sequence[tuple[Probe, list[np.ndarray]]]]


def motions_of(fitted: FittedModel) -> list[BaseMotion]:
    """Return the motion of the fitted model in each record, from which all candidates are
    simulated.
    """
    motions, layout = [], fitted.fit.layout
    for r, old in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        problem = _coarse(old, layout, fitted.system, p)
        assert problem.drive is not None
        motions.append(
            base_motion(
                problem,
                p,
                fitted.fit.linearisations[r].states,
                len(fitted.system.states),
                problem.drive,
            )
        )
    return motions


def _coarse(old: RecordProblem, layout: FitLayout, system: System, p: np.ndarray) -> RecordProblem:
    """Return a record of the fit laid out with the coarse sub-step, its inputs at parameters ``p
    (np,)``.
    """
    return record_problem(
        old.record,
        system,
        max(layout.settings.max_step, COARSE_STEP),
        (),
        (),
        valid=old.valid,
        at=p,
    )


def signatures_of(
    fitted: FittedModel, motions: Sequence[BaseMotion], effect: Traceable, probes: Sequence[Probe]
) -> list[list[np.ndarray]]:
    """Return, for each probe, the columns ``(m, N, k)`` of every record."""
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
        states = dict(
            zip(layout.system.state_names, fitted.fit.linearisations[r].states, strict=True)
        )
        trajectory = np.array(
            [
                states[name] if name in states else np.zeros(len(old.grid.nodes))
                for name in system.state_names
            ]
        )
        # If the fitted model's input path meets another input effect, both are simulated together.
        motion = (
            None
            if layout.system.input_stages and effect.station is Station.INPUT_PATH
            else motions[r]
        )
        y, changed = alternative_outputs(
            problem, base, trajectory, alternatives, len(layout.system.states), motion
        )
        # a divergent simulation has no signature and is left out
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
        steps = np.array([SLOPE_STEP * size[local] for local in probe.slopes])
        where.append((len(columns), len(steps), reference, steps))
        columns += [
            {**full, full_name(effect, local): probe.values[local] + step}
            for local, step in zip(probe.slopes, steps.tolist(), strict=True)
        ]
    return columns, where


def factors_prior(
    effect: Traceable, probe: Probe, context: SearchContext
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and sigma ``(k,)`` of the factors of a probe's columns."""
    if not probe.slopes:
        return np.ones(1), np.full(1, PLACED_SIZE_SHARE)
    items = {item.name: item for item in effect.parameters}
    means, sigmas = [], []
    for local in probe.slopes:
        known = prior_of(effect, items[local], probe.values[local], context)
        means.append(known.mean - probe.values[local])
        sigmas.append(known.sigma)
    return np.array(means), np.array(sigmas)


def candidate_signatures(
    fitted: FittedModel, candidates: Sequence[Traceable], context: SearchContext
) -> dict[int, CandidateSignatures]:
    """Return the signatures of all candidates at a fitted set, without divergent ones."""
    motions = motions_of(fitted)
    found: dict[int, CandidateSignatures] = {}
    for place, candidate in enumerate(candidates):
        if candidate.name in fitted.names or isinstance(candidate, NoiseEffect):
            continue
        effect = fitted_to(candidate, context)
        probes = tuple(effect.probes(context))
        if not probes:
            continue
        try:
            signatures = signatures_of(fitted, motions, effect, probes)
        except (ModelError, FloatingPointError):
            continue
        usable = [
            (probe, parts)
            for probe, parts in zip(probes, signatures, strict=True)
            if _stays_small(effect, probe, parts, context)
        ]
        if usable:
            found[place] = (effect, usable)
    return found


def _stays_small(
    effect: Traceable, probe: Probe, parts: Sequence[np.ndarray], context: SearchContext
) -> bool:
    """Return whether a signature of the usual size of its parameters did not run away."""
    _, usual = factors_prior(effect, probe, context)
    return all(np.all(np.abs(part) * usual < LARGEST_SIGNATURE) for part in parts)
