"""What a record says of the parameters to first order: its sensitivities in units of the noise, nuisances taken out."""

from __future__ import annotations

import numpy as np

from ident.whole_record.layout import FitSettings, lay_out
from ident.whole_record.linearise import linearise
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

MAX_STEP = 0.01  # longest sub-step, s: that of the whole-record fits


def weighted_sensitivities(record: Record, system: System, noise_std: np.ndarray, max_step: float = MAX_STEP) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of the free parameters and the slopes ``(M, n)`` of all measured samples by them, over the noise standard deviation ``(m,)``.

    At the parameters of ``system``, by complex steps. Biases and initial states are nuisances: what they could explain is projected out,
    with the priors that the system declares of them. The information of the record is ``S' S``; singular values of ``S`` tell directions
    without influence to rounding, of which those of ``S' S`` would leave half the digits.

    Raises
    ------
    ModelError : the simulation leaves all measure.
    """
    layout = lay_out([record], system, FitSettings(max_step=max_step, use_priors=True, exact=True))
    problem, n = layout.problems[0], len(layout.shared)
    p, x0 = layout.split(layout.start, 0)
    line = linearise(problem, p, x0, layout.guesses(layout.start)[0])
    line = linearise(problem, p, x0, line.states)
    if not np.all(np.isfinite(line.jacobian)):
        raise ModelError("the simulation leaves all measure", where=record.name, remedy="give starting values of a model that stays finite")
    slopes = (line.jacobian / np.asarray(noise_std)[:, None, None])[problem.valid]
    items = [system.parameters[name] for name in layout.local] + [system.initial.items[i] for i in layout.starts]
    known = np.array([1.0 / item.prior_std if np.isfinite(item.prior_std) else 0.0 for item in items])
    nuisance = np.vstack([slopes[:, n:], np.diag(known)])
    shared = np.vstack([slopes[:, :n], np.zeros((len(items), n))])
    basis = np.linalg.qr(nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300))[0]
    return layout.shared, shared - basis @ (basis.T @ shared)
