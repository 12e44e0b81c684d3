"""Signatures of a candidate before whitening and projection.

A signature is the change of the outputs of the fitted model by the candidate: at the parameter
values of a probe, or the derivative with respect to a parameter at these values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ident.estimate import overflow_tolerated
from ident.tracing.evidence import prior_of
from ident.tracing.fitted_model import FittedModel, compiled_with
from ident.whole_record.layout import FitLayout
from ident.whole_record.record_problem import RecordProblem, record_problem
from ident.whole_record.trial_outputs import BaseMotion, base_motion, trial_outputs
from sim.declaration.effect import NoiseEffect, Station, full_name
from sim.declaration.model import System
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to
from sim.errors import ModelError

# prior sigma of the factor on the signature of an event that is probed at one size
EVENT_SIZE_REL_SIGMA = 0.4
LARGEST_SIGNATURE = 1e6  # largest signature; the simulation of a larger one diverged
SLOPE_STEP = 1e-4  # step of finite differences, relative to the size of the parameter
COARSE_STEP = 0.025  # s, sub-step that is accurate enough to rank candidates


# An effect, and for each of its probes the signatures in each record: ``(m, N, k)``, m outputs,
# N samples, k columns: one for each parameter in ``slopes`` of the probe, or a single one.
CandidateSignatures = tuple[Traceable, Sequence[tuple[Probe, list[np.ndarray]]]]


def base_motions(fitted: FittedModel) -> list[BaseMotion]:
    """Return the simulated motion of the fitted model in each record.

    Candidates are simulated as deviations from it, which saves most of the work.
    """
    motions, layout = [], fitted.fit.layout
    for r, fitted_problem in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        problem = _coarse(fitted_problem, layout, fitted.system, p)
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


def _coarse(
    fitted_problem: RecordProblem, layout: FitLayout, system: System, p: np.ndarray
) -> RecordProblem:
    """Return the problem of one record with coarse sub-steps.

    ``p (n_p,)`` : parameters of the system. Input effects are applied with these values.
    """
    return record_problem(
        fitted_problem.record,
        system,
        max(layout.settings.max_step, COARSE_STEP),
        (),
        (),
        valid=fitted_problem.valid,
        at=p,
    )


def simulated_signatures(
    fitted: FittedModel, motions: Sequence[BaseMotion], effect: Traceable, probes: Sequence[Probe]
) -> list[list[np.ndarray]]:
    """Return the signatures ``(m, N, k)`` of an effect: a list by probe of lists by record.

    ``motions`` : of the fitted model, from ``base_motions``.
    """
    outputs = [signal.name for signal in fitted.system.outputs]
    _, system = compiled_with(fitted.model, [effect], outputs)
    layout = fitted.fit.layout
    parameter_sets, probe_simulations = _trial_parameters(effect, probes)
    by_probe: list[list[np.ndarray]] = [[] for _ in probes]
    for r, fitted_problem in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        fitted_values = dict(zip(layout.system.parameters.names, p.tolist(), strict=True))
        base = np.array([fitted_values.get(item.name, item.value) for item in system.parameters])
        for local, value in effect.absent.items():
            base[system.parameters.index(full_name(effect, local))] = value
        trials = np.repeat(base[:, None], len(parameter_sets), axis=1)
        for column, values in enumerate(parameter_sets):
            for name, value in values.items():
                trials[system.parameters.index(name), column] = value
        problem = _coarse(fitted_problem, layout, system, base)
        states = dict(
            zip(layout.system.state_names, fitted.fit.linearisations[r].states, strict=True)
        )
        trajectory = np.array(
            [
                states[name] if name in states else np.zeros(len(fitted_problem.grid.nodes))
                for name in system.state_names
            ]
        )
        # If effects of the set and the candidate act on the inputs, the base motion has other
        # inputs and cannot be reused: None computes it anew.
        motion = (
            None
            if layout.system.input_stages and effect.station is Station.INPUT_PATH
            else motions[r]
        )
        y, trial_y = trial_outputs(
            problem, base, trajectory, trials, len(layout.system.states), motion
        )
        # Overflows of divergent simulations are silenced here; `_stays_small` discards them later.
        with overflow_tolerated():
            for by_record, (first, size, reference, steps) in zip(
                by_probe, probe_simulations, strict=True
            ):
                subtracted = (
                    y[:, :, None] if reference < 0 else trial_y[:, :, reference : reference + 1]
                )
                by_record.append((trial_y[:, :, first : first + size] - subtracted) / steps)
    return by_probe


class _ProbeSimulations(NamedTuple):
    """The simulations from which the signatures of one probe are computed.

    Attributes
    ----------
    first : index of the first simulation.
    size : number k of simulations.
    reference : index of the simulation that is subtracted; -1 is the fitted model.
    steps : ``(k,)`` step of each difference.
    """

    first: int
    size: int
    reference: int
    steps: np.ndarray


def _trial_parameters(
    effect: Traceable, probes: Sequence[Probe]
) -> tuple[list[dict[str, float]], list[_ProbeSimulations]]:
    """Return the parameter values of all simulations by full name, and the simulations from which
    the signatures of each probe are computed.
    """
    sizes = {item.name: abs(item.value) or 1.0 for item in effect.parameters}
    parameter_sets: list[dict[str, float]] = []
    probe_simulations = []
    for probe in probes:
        full = {full_name(effect, local): value for local, value in probe.values.items()}
        if not probe.slopes:
            probe_simulations.append(_ProbeSimulations(len(parameter_sets), 1, -1, np.ones(1)))
            parameter_sets.append(full)
            continue
        reference = -1
        if any(probe.values.get(local) != value for local, value in effect.absent.items()):
            reference = len(parameter_sets)
            parameter_sets.append(full)
        steps = np.array([SLOPE_STEP * sizes[local] for local in probe.slopes])
        probe_simulations.append(
            _ProbeSimulations(len(parameter_sets), len(steps), reference, steps)
        )
        parameter_sets += [
            {**full, full_name(effect, local): probe.values[local] + step}
            for local, step in zip(probe.slopes, steps.tolist(), strict=True)
        ]
    return parameter_sets, probe_simulations


def coefficient_prior(
    effect: Traceable, probe: Probe, context: SearchContext
) -> tuple[np.ndarray, np.ndarray]:
    """Return the prior mean and sigma ``(k,)`` of the coefficients by which the signatures of a
    probe are multiplied: each parameter minus its value at the probe, or the size of an event.
    """
    if not probe.slopes:
        return np.ones(1), np.full(1, EVENT_SIZE_REL_SIGMA)
    items = {item.name: item for item in effect.parameters}
    means, sigmas = [], []
    for local in probe.slopes:
        prior = prior_of(effect, items[local], probe.values[local], context)
        means.append(prior.mean - probe.values[local])
        sigmas.append(prior.sigma)
    return np.array(means), np.array(sigmas)


def candidate_signatures(
    fitted: FittedModel, candidates: Sequence[Traceable], context: SearchContext
) -> dict[int, CandidateSignatures]:
    """Return the signatures of all candidates at a fitted set, by position in ``candidates``.

    Omitted are effects of the set, noise effects, and probes whose simulation diverges.
    """
    motions = base_motions(fitted)
    signatures_by_candidate: dict[int, CandidateSignatures] = {}
    for number, candidate in enumerate(candidates):
        if candidate.name in fitted.names or isinstance(candidate, NoiseEffect):
            continue
        effect = fitted_to(candidate, context)
        probes = tuple(effect.probes(context))
        if not probes:
            continue
        try:
            signatures = simulated_signatures(fitted, motions, effect, probes)
        except (ModelError, FloatingPointError):
            continue
        bounded = [
            (probe, by_record)
            for probe, by_record in zip(probes, signatures, strict=True)
            if _stays_small(effect, probe, by_record, context)
        ]
        if bounded:
            signatures_by_candidate[number] = (effect, bounded)
    return signatures_by_candidate


def _stays_small(
    effect: Traceable, probe: Probe, by_record: Sequence[np.ndarray], context: SearchContext
) -> bool:
    """Return whether the signatures of a probe in all records are below ``LARGEST_SIGNATURE``, each
    multiplied by the prior sigma of its coefficient.
    """
    _, sigma = coefficient_prior(effect, probe, context)
    return all(np.all(np.abs(signature) * sigma < LARGEST_SIGNATURE) for signature in by_record)
