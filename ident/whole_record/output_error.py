"""Output-error fit: maximum likelihood without process noise, over one or several whole records.

Maine and Iliff, NASA RP-1138; Jategaonkar, Flight Vehicle System Identification, ch. 4. Parameters are
shared by all records; initial states and the parameters named local belong to one record each.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import LARGEST, Estimate, Outcome
from ident.statistics.coloured_covariance import corrected_covariance
from ident.statistics.information import determined_and_open, inverse_information
from ident.statistics.normal_equations import add_normal_equations
from ident.whole_record.best_start import fit_from_best_start, in_pieces, put_together, quiet, said_of_pieces, started_unstable
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import FitLayout, FitSettings, lay_out
from ident.whole_record.numerical_error import with_integration_error
from ident.whole_record.unstable_motion import projected_covariance
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

METHOD = "output-error"
_NOISY = 1e3  # roundings from which a residual is one: nearly exact data leave a few
__all__ = ["FitSettings", "fit_output_error"]


def fit_output_error(records: Sequence[Record], system: System, settings: FitSettings | None = None, *, local: Collection[str] = ()) -> Estimate:
    """Fit the free parameters of a System to records by whole-record simulation.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : not compiled on line; bounds, and with ``use_priors`` priors, from its declaration.
    local : further parameters of which each record has its own; they are not returned.

    Returns
    -------
    Estimate of the shared free parameters; biases and initial states are nuisances, projected out of the covariance.
    Outcome ``NOT_IDENTIFIABLE`` when a direction of the parameters has no influence, ``DIVERGED`` when no finite
    cost was found, ``MAX_ITERATIONS`` when it had not settled, ``DEGENERATE`` when an output is met exactly and another is not.
    Where the start is unstable or its simulation runs away, or a fit from it does not settle, the fit begins from equation error, and a
    motion that grows beyond what can be followed is cut, which ``message`` tells: see `ident.whole_record.best_start`.

    Raises
    ------
    ModelError : a record without any of the outputs, or nothing to estimate.
    """
    settings = settings or FitSettings()
    found = _fitted(records, system, settings, local)
    if found.outcome in (Outcome.CONVERGED, Outcome.DEGENERATE):
        return found
    unstable = started_unstable(records, system, settings, local)
    again = found if unstable is None else _fitted(records, unstable, settings, local)
    return again if again.outcome is Outcome.CONVERGED else found


def _fitted(records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str]) -> Estimate:
    layout = lay_out(records, system, settings, local=local)
    pieces = in_pieces(records, system, settings, local, layout)
    if sum(len(each) for each in pieces) > len(records):
        layout = lay_out([piece for each in pieces for piece in each], system, settings, local=local)
    if not layout.shared:
        raise ModelError("no parameter is free", where=f"model with {', '.join(system.parameters.names)}", remedy="release at least one")
    fit = fit_from_best_start(layout)
    found = failed_estimate(layout) if fit is None else estimate_of(fit)
    said = "; ".join(sentence for sentence in (said_of_pieces(pieces), found.message) if sentence)
    return replace(found, fitted=put_together(found.fitted, pieces), message=said)


def shared_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Covariance of the shared parameters ``(s, s)`` and whether all are determined; of a motion that grows without squaring its sensitivities."""
    n = len(fit.layout.shared)
    if fit.layout.prior is None and n and not quiet(fit.layout, fit.theta):
        return projected_covariance(fit)
    covariance, determined = fit_covariance(fit)
    return covariance[:n, :n], determined


def degenerate(fit: Fit) -> bool:
    """Whether some output is met to rounding while another is far from it: the one without noise outweighs all others without bound."""
    above = np.sqrt(fit.variance / fit.layout.smallest)[fit.layout.used]
    return bool(np.any(above <= 1.0) and np.any(above > _NOISY))


def fit_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Covariance of all unknowns ``(n, n)``, corrected for coloured residuals as the settings say, and whether all are determined."""
    normal, _ = fit.normal_equations()
    inverse, determined = inverse_information(normal, fit.theta)
    if not fit.layout.settings.coloured:
        return inverse, determined
    layout = fit.layout
    parts = [(layout.columns(r), fit.jacobians[r], fit.residuals[r], problem.valid) for r, problem in enumerate(layout.problems)]
    known = prior_information(fit)
    if fit.noise_model.names:
        # What innovation covariances say of the unknowns, and the prior: no colour of the residuals changes that.
        known = np.array(normal)
        for r, problem in enumerate(layout.problems):
            weight = np.where(problem.valid, -1.0 / fit.variance[:, None], 0.0)
            add_normal_equations(known, np.zeros(len(known)), layout.columns(r), fit.jacobians[r], fit.residuals[r], weight)
    if determined:
        return corrected_covariance(inverse, parts, fit.variance, known), True
    resolved, unknown = determined_and_open(normal, fit.theta)
    return corrected_covariance(resolved, parts, fit.variance, known) + unknown, False


def prior_information(fit: Fit) -> np.ndarray | None:
    """What the priors of a fit say of its unknowns, ``(n, n)``; None where it counts none."""
    prior = fit.layout.prior
    if prior is None:
        return None
    out = np.zeros((len(fit.theta), len(fit.theta)))
    out[np.ix_(prior.positions, prior.positions)] = prior.information
    return out


def estimate_of(fit: Fit) -> Estimate:
    """The shared parameters of a fit as an Estimate; its covariance holds the error of the integration where that counts."""
    layout, n = fit.layout, len(fit.layout.shared)
    covariance, determined = shared_covariance(fit)
    outcome = Outcome.DEGENERATE if degenerate(fit) else fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    found = Estimate(
        METHOD,
        layout.shared,
        tuple(layout.system.parameters[name].unit for name in layout.shared),
        fit.theta[:n].copy(),
        covariance,
        outcome,
        fit.log_likelihood,
        layout.system.output_names,
        np.sqrt(fit.variance),
        tuple(line.y for line in fit.lines),
        iterations=fit.iterations,
    )
    return with_integration_error(found, fit) if quiet(layout, fit.theta) else found


def failed_estimate(layout: FitLayout, method: str = METHOD) -> Estimate:
    """The start of a layout with sigmas as large as itself, for a fit that found no finite cost."""
    theta = layout.start[: len(layout.shared)]
    return Estimate(
        method,
        layout.shared,
        tuple(layout.system.parameters[name].unit for name in layout.shared),
        theta.copy(),
        np.diag(np.maximum(1.0, theta**2)),
        Outcome.DIVERGED,
        -LARGEST,
        layout.system.output_names,
        np.ones(len(layout.used)),
        tuple(np.zeros_like(problem.z) for problem in layout.problems),
    )
