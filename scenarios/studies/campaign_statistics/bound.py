"""What the best estimator with a method's priors could do on a campaign's flight: the Cramer-Rao bound at the reference values.

A linear-Gaussian estimator with the information F of the data and the prior information P0 about theta0 has the posterior covariance
P = (F + P0)^-1 and moves theta0 to P F theta_data + P P0 theta0. Over records the prior does not scatter: the estimate scatters by P F P, less
than P, and lies P P0 (theta0 - theta) off. Each further pass of a filter starts at the result of the one before and counts its prior anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ident.banks.bank import filter_batched
from ident.filters.ekf import run_ekf
from ident.statistics.information import inverse_information
from ident.whole_record.layout import weighted_sensitivities
from scenarios.studies.declaration import Estimation
from scenarios.studies.estimating import biased_system, compiled, filter_settings
from scenarios.studies.runs.work import EstimatorRuns
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.errors import FlightidError
from sim.record import Record
from sim.truth.flight import Truth

WIDE = 30.0  # priors by which a filter about exact data is told next to nothing
FILTERS = ("ekf", "ukf")
_STEP = 1e-4  # of differences, as a share of a parameter
_LEAST = 1e-10  # of the largest singular value: what differences of flights still resolve


@dataclass(frozen=True, eq=False)
class Bound:
    """At the reference values, of each parameter ``(n,)`` in its unit.

    Attributes
    ----------
    data : least standard deviation of an unbiased estimate from one record alone; infinite where the record leaves it open.
    scatter : least standard deviation over runs of an estimate that counts the method's priors, which keep it from scattering.
    pull : by how much these priors move its mean. stated : the standard deviation that it would state.
    gain : ``(n, n)`` from the scores ``slopes' residuals`` to estimates; ``slopes (M, n)`` of the measured samples in units of the noise,
        what states at the start and zeros of sensors explain taken out; None where process noise acts.
    """

    names: tuple[str, ...]
    data: np.ndarray
    scatter: np.ndarray
    pull: np.ndarray
    stated: np.ndarray
    gain: np.ndarray
    slopes: np.ndarray | None = None

    @property
    def prior_share(self) -> np.ndarray:
        """Share of each stated variance that comes from the prior, ``(n,)``."""
        return np.clip(1.0 - (self.scatter / self.stated) ** 2, 0.0, 1.0)


def bound_of(work: EstimatorRuns) -> Bound | None:
    """The bound of a campaign's method; None where the model's sensitivities have no finite numbers."""
    common, estimation, names = work.common, work.estimation, work.parameters
    model = common.model.with_values({name: common.reference[name] for name in names})
    noise = Noise({name: common.truth.noise_std[name] for name in estimation.outputs}, common.truth.process_density)
    if any(not noise.measurement_std[name] > 0.0 for name in estimation.outputs):
        return None  # exact data bound nothing
    slopes: np.ndarray | None = None
    try:
        if common.truth.process_density:
            data: np.ndarray | None = _forced(estimation, model.with_noise(noise), common.record, common.truth)
        else:
            slopes = _calm(estimation, model.with_noise(noise), common.record, names)
            data = slopes.T @ slopes
    except (FlightidError, np.linalg.LinAlgError):
        return None
    if data is None or not np.all(np.isfinite(data)):
        return None
    return replace(_with_priors(estimation, names, data, np.array([common.reference[name] for name in names])), slopes=slopes)


def _calm(estimation: Estimation, model: Model, record: Record, names: tuple[str, ...]) -> np.ndarray:
    """Slopes ``(M, n)`` of a record without process noise in units of the noise, states at the start and zeros of sensors taken out."""
    if estimation.method in FILTERS:
        system = compile_model(model, estimation.outputs)
    else:
        if not estimation.use_priors:
            model = replace(model, initial=model.initial.with_prior(dict.fromkeys(model.initial.names, math.inf)))
        system = biased_system(estimation, model)
    levels = np.array([model.noise.measurement_std[name] for name in system.output_names])
    found, slopes = weighted_sensitivities(record, system, levels)
    return np.asarray(slopes[:, [found.index(name) for name in names]])


def _forced(estimation: Estimation, model: Model, record: Record, truth: Truth) -> np.ndarray | None:
    """Information ``(n, n)`` with process noise: what a Kalman filter with the true levels gains on exact data, which keep it at the reference."""
    system = compile_model(model, estimation.outputs)
    if any(name not in system.state_names for name in model.noise.process_density):
        return None  # a parameter that drifts has no one value that could be bounded
    free = model.parameters.free_names
    prior = {name: WIDE * estimation.start[name].std for name in free}
    if not all(map(math.isfinite, prior.values())):
        return None
    exact = replace(record, outputs=tuple(replace(each, values=truth.outputs[each.name]) for each in record.outputs))
    told = replace(model, parameters=model.parameters.with_prior(prior))
    once = replace(estimation, method="ekf", passes=1)
    found = run_ekf(exact, compiled(once, told), filter_settings(once), by=filter_batched).only(free)
    information = np.linalg.inv(found.covariance) - np.diag([prior[name] ** -2.0 for name in found.names])
    order = [found.names.index(name) for name in free]
    return np.asarray(information[np.ix_(order, order)])


def _with_priors(estimation: Estimation, names: tuple[str, ...], data: np.ndarray, reference: np.ndarray) -> Bound:
    alone, _ = inverse_information(data)
    alone_std = np.sqrt(np.diag(alone))
    prior = np.array([estimation.start[name].std for name in names])
    if estimation.method in FILTERS or estimation.use_priors:
        passes = estimation.passes if estimation.method in FILTERS else 1
        start = np.array([estimation.start[name].value for name in names])
        stated, gain, left = _passes(data, prior, passes, estimation.spread)
        scatter, pull = np.sqrt(np.maximum(np.diag(gain @ data @ gain.T), 0.0)), left @ (start - reference)
    else:
        stated, scatter, pull, gain = alone_std, alone_std, np.zeros(len(names)), alone
    # What is known a thousand times worse than before the flight is open: its bound is the arithmetic's.
    open_ = alone_std > 1e3 * np.where(np.isfinite(prior), prior, np.inf)
    return Bound(names, np.where(open_, np.inf, alone_std), scatter, pull, stated, gain)


def _passes(data: np.ndarray, prior: np.ndarray, passes: int, spread: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stated deviation ``(n,)`` after the last pass; what the scores of the data and the first start are multiplied by, ``(n, n)`` each."""
    n, width = len(prior), prior
    gain, left, stated = np.zeros((n, n)), np.eye(n), prior
    for _ in range(passes):
        told = np.diag(np.where(np.isfinite(width), width, np.inf) ** -2.0)
        covariance = inverse_information(data + told)[0]
        gain, left = covariance + covariance @ told @ gain, covariance @ told @ left
        stated = np.sqrt(np.diag(covariance))
        width = np.minimum(prior, spread * stated) if math.isfinite(spread) else prior
    return stated, gain, left


def cramer_rao(
    model: Model, again: Callable[[Model], Record], noise: Mapping[str, float], names: Sequence[str], biased: Mapping[str, float]
) -> Mapping[str, float]:
    """The least standard deviation of each of some parameters that any unbiased estimate from one record with white noise can have.

    Slopes are central differences of whole flights, nothing of an estimator. Unknown beside the parameters are where the states begin and a
    bias of each output in ``biased``, with what is known of it (a standard deviation, or infinity). ``again`` flies a model without noise,
    ``noise`` has the standard deviations by output.
    """

    def outputs(changed: Model) -> np.ndarray:
        record = again(changed)
        return np.concatenate([record[name].values / std for name, std in noise.items()])

    def slope(moved: Callable[[float], Model], step: float) -> np.ndarray:
        return (outputs(moved(step)) - outputs(moved(-step))) / (2.0 * step)

    def valued(step: float, name: str) -> Model:
        return model.with_values({name: model.parameters[name].value + step})

    def started(step: float, name: str) -> Model:
        return model.with_initial(model.initial.with_values({name: model.initial[name].value + step}))

    columns = [slope(partial(valued, name=name), _STEP * (abs(model.parameters[name].value) or 1.0)) for name in names]
    columns += [slope(partial(started, name=state.name), _STEP * max(abs(state.value), 1.0)) for state in model.initial]
    count = len(columns[0]) // len(noise)
    columns += [np.repeat([(name == each) / std for each, std in noise.items()], count) for name in biased]
    known = np.diag([*np.zeros(len(columns) - len(biased)), *(1.0 / std for std in biased.values())])
    jacobian = np.vstack([np.array(columns).T, known])
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = np.inf  # a state whose start moves nothing
    # Of the slopes themselves, not of their products, which have half the digits.
    inverse = np.linalg.pinv(jacobian / size, rcond=_LEAST)
    return dict(zip(names, (np.linalg.norm(inverse, axis=1) / size)[: len(names)].tolist(), strict=True))
