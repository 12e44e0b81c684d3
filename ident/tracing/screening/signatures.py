"""What a candidate would change of the outputs of a fitted model, at places of its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.estimate import counted_numerics
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, compiled_with
from ident.tracing.screening.alternative_outputs import BaseMotion, alternative_outputs, base_motion
from ident.whole_record.layout import FitLayout
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.effect import Station, full_name
from sim.declaration.model import System
from sim.declaration.proposal import Probe, Traceable


def motions_of(fitted: FittedModel) -> list[BaseMotion]:
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


def signatures_of(
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
