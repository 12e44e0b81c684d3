"""The declared model fitted to the records, and what it predicts of data that are not fitted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.tracing.diagnosis import Claim, Step
from ident.tracing.fitted_model import FittedModel
from ident.tracing.held_out import HeldOutData, fit_held_out
from ident.tracing.problem import TraceProblem
from ident.tracing.wrong_samples import cleaned_inputs, held_out_masks, mended_inputs, spike_masks
from ident.whole_record.output_error import failed_fit
from sim.errors import ModelError
from sim.record import LARGEST_MEASURED, Record, refuse_beyond_measure

# lower bound of a noise level, as a share of the noise at high frequencies: logged signals are
# filtered
LEAST_NOISE = 0.3


@dataclass(frozen=True, eq=False)
class Declared:
    """The declared model as fitted.

    Attributes
    ----------
    problem : with inputs mended and provisional spikes masked.
    root : the fit.
    spikes : claims of wrong samples in recorded inputs.
    steps : the steps taken.
    """

    problem: TraceProblem
    root: FittedModel
    spikes: tuple[Claim, ...]
    steps: tuple[Step, ...] = ()


def fit_declared(problem: TraceProblem) -> Declared:
    """Fit the declared model, mend recorded inputs and mask provisional spikes.

    Raises
    ------
    ModelError : no finite cost, or a failed fit (``ident.whole_record.output_error``).
    RecordError : an angle or rate in the fit that no aircraft can have.
    """
    for record in problem.records:
        measured = [name for name in problem.outputs if name in record.output_names]
        angles = [name for name in measured if record[name].unit in ("rad", "rad/s")]
        refuse_beyond_measure(record, angles, LARGEST_MEASURED)
    problem.progress("fitting the declared model", 0.0)
    root = problem.fit((), None)
    if root is None:
        raise ModelError(
            "the declared model has no finite cost on these records",
            where=problem.records[0].name,
            remedy="check units and starting values",
        )
    values = {item.name: item.value for item in problem.model.parameters if item.free}
    why, remedy = failed_fit(root.fit, values)
    if why:  # a second attempt from where the first one ended
        root = problem.fit((), root) or root
        why, remedy = failed_fit(root.fit, values)
    if why:
        names = ", ".join(dict.fromkeys(record.name for record in problem.records))
        what = f"the fit of the declared model has failed: {why}"
        raise ModelError(what, where=names, remedy=remedy)
    problem, root, spikes, steps = cleaned_inputs(problem, root)
    least = {name: LEAST_NOISE * std for name, std in measured_noise(root).items()}
    problem = replace(problem, least_noise=least)
    masked = problem.with_masks(spike_masks(problem, root))
    again = masked.fit((), root)
    if again is None:
        return Declared(problem, root, tuple(spikes), tuple(steps))
    return Declared(masked, again, tuple(spikes), tuple(steps))


def measured_noise(fitted: FittedModel) -> dict[str, float]:
    """Return the standard deviation of each output's noise, from third differences of its residual.

    Motion hardly affects third differences; the median is robust against single wrong samples.
    """
    found: dict[str, float] = {}
    layout = fitted.fit.layout
    for i, name in enumerate(fitted.system.output_names):
        sizes = [
            float(np.median(np.abs(np.diff(residual[i][problem.valid[i]], 3))))
            for problem, residual in zip(layout.problems, fitted.fit.residuals, strict=True)
            if np.count_nonzero(problem.valid[i]) > 4
        ]
        if sizes:
            found[name] = float(np.mean(sizes)) / (0.6745 * math.sqrt(20.0))
    return found


def held_out_data(declared: Declared, validation: Sequence[Record]) -> HeldOutData:
    """Return the held-out records with mended inputs, their masks and the declared model's fit."""
    if not validation:
        return HeldOutData()
    problem = declared.problem
    records = [mended_inputs(problem, record, declared.spikes) for record in validation]
    first = fit_held_out(declared.root, records, None, informed=False)
    masks = held_out_masks(first, records, problem.outputs)
    return HeldOutData(records, masks, fit_held_out(declared.root, records, masks, informed=False))
