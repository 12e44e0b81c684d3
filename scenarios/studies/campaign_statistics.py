"""Statistics of a campaign's runs and the Cramer-Rao bound, and their files.

F is the information of the data, and P0 that of a prior about theta0. A linear estimator with
Gaussian noise has the posterior covariance P = (F + P0)^-1 and the estimate
P F theta_data + P P0 theta0. The prior is the same for all records. Over many records the estimates
therefore have the covariance P F P, smaller than P, and the bias P P0 (theta0 - theta). A filter
with several passes applies its prior in each pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ident.banks.bank import filter_batched
from ident.filters.ekf import run_ekf
from ident.statistics.intervals import (
    clopper_pearson,
    deviation_factors,
    inverse_information,
    mean_square_interval,
    within_chi_square,
)
from ident.whole_record.layout import weighted_sensitivities
from scenarios.files.writing import csv_text
from scenarios.studies.campaign import CampaignRuns, EstimatorRuns, Spread
from scenarios.studies.declaration import FILTERS, Estimation
from scenarios.studies.estimating import biased_system, compiled, filter_settings
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.errors import FlightidError
from sim.record import Record
from sim.truth.flight import Truth

# ---- Cramer-Rao bound for the flight of a campaign and the priors of its method

WIDE_PRIOR_FACTOR = 30.0  # factor on priors, after which they add no information
OPEN_PRIOR_FACTOR = 1e3  # a data bound of more prior sigmas is rounding error
_DIFFERENCE_STEP_SHARE = 1e-4  # step of finite differences, as a share of a parameter
# Finite differences do not resolve singular values below this share of the largest one.
_RESOLVED_SINGULAR_VALUE_SHARE = 1e-10


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramer-Rao bound at the reference values; shape ``(n,)``, in the units of the parameters.

    Attributes
    ----------
    names : names of the parameters.
    data : least standard deviation of an unbiased estimate without priors; infinite if the record
        does not determine the parameter.
    scatter : least standard deviation over runs of an estimate with the priors of the method.
    pull : bias that these priors cause.
    stated : standard deviation that the estimate with priors reports.
    gain : shape ``(n, n)``; times the scores ``slopes.T @ residuals`` it gives estimates.
    slopes : sensitivities in units of the noise, shape ``(M, n)``, orthogonal to those of initial
        states and biases; None with process noise.
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
        """Share of the prior in each stated variance, ``(n,)``."""
        return np.clip(1.0 - (self.scatter / self.stated) ** 2, 0.0, 1.0)


def bound_of(work: EstimatorRuns) -> Bound | None:
    """Return the bound of a campaign's method; None if a sensitivity is not finite."""
    common, estimation, names = work.common, work.estimation, work.parameters
    model = common.model.with_values({name: common.reference[name] for name in names})
    noise = Noise(
        {name: common.truth.noise_std[name] for name in estimation.outputs},
        common.truth.process_density,
    )
    if any(not noise.measurement_std[name] > 0.0 for name in estimation.outputs):
        return None  # no bound without noise
    slopes: np.ndarray | None = None
    with_noise = model.with_noise(noise)
    try:
        if common.truth.process_density:
            data = _information_with_process_noise(
                estimation, with_noise, common.record, common.truth
            )
        else:
            slopes = _slopes(estimation, with_noise, common.record, names)
            data = slopes.T @ slopes
    except (FlightidError, np.linalg.LinAlgError):
        return None
    if data is None or not np.all(np.isfinite(data)):
        return None
    reference = np.array([common.reference[name] for name in names])
    return replace(_with_priors(estimation, names, data, reference), slopes=slopes)


def _slopes(
    estimation: Estimation, model: Model, record: Record, names: tuple[str, ...]
) -> np.ndarray:
    """Return ``Bound.slopes`` of a record without process noise."""
    if estimation.method in FILTERS:
        system = compile_model(model, estimation.outputs)
    else:
        if not estimation.use_priors:
            model = replace(
                model,
                initial=model.initial.with_prior(dict.fromkeys(model.initial.names, math.inf)),
            )
        system = biased_system(estimation, model)
    levels = np.array([model.noise.measurement_std[name] for name in system.output_names])
    parameters, slopes = weighted_sensitivities(record, system, levels)
    return np.asarray(slopes[:, [parameters.index(name) for name in names]])


def _information_with_process_noise(
    estimation: Estimation, model: Model, record: Record, truth: Truth
) -> np.ndarray | None:
    """Return the information of a record with process noise, shape ``(n, n)``.

    It is that of a Kalman filter with the true noise levels. The filter runs over data without
    noise, so that it stays linearised at the reference values.
    """
    system = compile_model(model, estimation.outputs)
    if any(name not in system.state_names for name in model.noise.process_density):
        return None  # a drifting parameter has no single value
    free = model.parameters.free_names
    prior = {name: WIDE_PRIOR_FACTOR * estimation.start[name].std for name in free}
    if not all(map(math.isfinite, prior.values())):
        return None
    exact = replace(
        record,
        outputs=tuple(
            replace(output, values=truth.outputs[output.name]) for output in record.outputs
        ),
    )
    with_prior = replace(model, parameters=model.parameters.with_prior(prior))
    one_pass = replace(estimation, method="ekf", passes=1)
    system, settings = compiled(one_pass, with_prior), filter_settings(one_pass)
    estimate = run_ekf(exact, system, settings, by=filter_batched).only(free)
    prior_information = np.diag([prior[name] ** -2.0 for name in estimate.names])
    information = np.linalg.inv(estimate.covariance) - prior_information
    order = [estimate.names.index(name) for name in free]
    return np.asarray(information[np.ix_(order, order)])


def _with_priors(
    estimation: Estimation, names: tuple[str, ...], data: np.ndarray, reference: np.ndarray
) -> Bound:
    """Return the bound for the information ``data`` and the priors of an estimation."""
    data_covariance, _ = inverse_information(data)
    data_std = np.sqrt(np.diag(data_covariance))
    prior = np.array([estimation.start[name].std for name in names])
    if estimation.method in FILTERS or estimation.use_priors:
        passes = estimation.passes if estimation.method in FILTERS else 1
        start = np.array([estimation.start[name].value for name in names])
        stated, gain, start_gain = _passes(data, prior, passes, estimation.spread)
        scatter = np.sqrt(np.maximum(np.diag(gain @ data @ gain.T), 0.0))
        pull = start_gain @ (start - reference)
    else:
        stated, scatter, pull, gain = data_std, data_std, np.zeros(len(names)), data_covariance
    # The record does not determine these parameters.
    is_open = data_std > OPEN_PRIOR_FACTOR * np.where(np.isfinite(prior), prior, np.inf)
    return Bound(names, np.where(is_open, np.inf, data_std), scatter, pull, stated, gain)


def _passes(
    data: np.ndarray, prior: np.ndarray, passes: int, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what several passes of an estimator with priors report.

    Parameters
    ----------
    data : information of the data, shape ``(n, n)``.
    prior : prior standard deviations, shape ``(n,)``.
    spread : largest prior of a further pass, in sigmas of the pass before.

    Returns
    -------
    Standard deviation that the last pass states, ``(n,)``; gain of the scores of the data on the
    estimate, ``(n, n)``; gain of the error of the first start on the estimate, ``(n, n)``.
    """
    n, pass_prior = len(prior), prior
    gain, start_gain, stated = np.zeros((n, n)), np.eye(n), prior
    for _ in range(passes):
        finite = np.where(np.isfinite(pass_prior), pass_prior, np.inf)
        prior_information = np.diag(finite**-2.0)
        covariance = inverse_information(data + prior_information)[0]
        gain = covariance + covariance @ prior_information @ gain
        start_gain = covariance @ prior_information @ start_gain
        stated = np.sqrt(np.diag(covariance))
        pass_prior = np.minimum(prior, spread * stated) if math.isfinite(spread) else prior
    return stated, gain, start_gain


def cramer_rao(
    model: Model,
    simulate: Callable[[Model], Record],
    noise: Mapping[str, float],
    names: Sequence[str],
    biased: Mapping[str, float],
) -> Mapping[str, float]:
    """Return the Cramer-Rao bound of parameters from one record with white noise.

    The bound is a standard deviation. Sensitivities are central differences of simulated flights,
    independent of any estimator. Initial states and biases are unknown, too.

    Parameters
    ----------
    model : the model at the values of the bound.
    simulate : simulates a model without noise.
    noise : standard deviation of the noise by output.
    names : the parameters.
    biased : prior standard deviation of the bias by output; may be infinite.
    """

    def outputs(changed: Model) -> np.ndarray:
        record = simulate(changed)
        return np.concatenate([record[name].values / std for name, std in noise.items()])

    def slope(changed_by: Callable[[float], Model], step: float) -> np.ndarray:
        return (outputs(changed_by(step)) - outputs(changed_by(-step))) / (2.0 * step)

    def with_value(step: float, name: str) -> Model:
        return model.with_values({name: model.parameters[name].value + step})

    def with_initial(step: float, name: str) -> Model:
        return model.with_initial(
            model.initial.with_values({name: model.initial[name].value + step})
        )

    columns = [
        slope(
            partial(with_value, name=name),
            _DIFFERENCE_STEP_SHARE * (abs(model.parameters[name].value) or 1.0),
        )
        for name in names
    ]
    columns += [
        slope(
            partial(with_initial, name=state.name),
            _DIFFERENCE_STEP_SHARE * max(abs(state.value), 1.0),
        )
        for state in model.initial
    ]
    count = len(columns[0]) // len(noise)
    columns += [
        np.repeat([(name == output) / std for output, std in noise.items()], count)
        for name in biased
    ]
    prior = np.diag(
        [*np.zeros(len(columns) - len(biased)), *(1.0 / std for std in biased.values())]
    )
    jacobian = np.vstack([np.array(columns).T, prior])
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = np.inf  # a state without effect on the outputs
    # Products of the slopes would lose half of the digits.
    inverse = np.linalg.pinv(jacobian / size, rcond=_RESOLVED_SINGULAR_VALUE_SHARE)
    return dict(
        zip(names, (np.linalg.norm(inverse, axis=1) / size)[: len(names)].tolist(), strict=True)
    )


# ---- Statistics of a campaign's runs

SIGMAS = (1, 2, 3)
# Probability of a normal distribution within 1, 2 and 3 standard deviations.
NORMAL = {1: 0.682689492137086, 2: 0.954499736103642, 3: 0.997300203936740}


@dataclass(frozen=True)
class Within:
    """Coverage: share of the runs whose interval contains the reference.

    Attributes
    ----------
    sigmas : half the length of the interval, in reported standard deviations.
    hits : number of runs whose interval contains the reference.
    runs : number of runs.
    share : hits over runs.
    interval : exact 95 % interval of the share.
    """

    sigmas: int
    hits: int
    runs: int
    share: float
    interval: tuple[float, float]

    @property
    def right(self) -> bool:
        """Whether the interval contains the share of a normal distribution."""
        return self.interval[0] <= NORMAL[self.sigmas] <= self.interval[1]


@dataclass(frozen=True, eq=False)
class ParameterStatistics:
    """One parameter over the runs that converged, SI.

    Attributes
    ----------
    reference : value from which errors count.
    bias : mean error.
    bias_std : standard deviation of the mean error.
    scatter : standard deviation of the estimates.
    reported : root mean square of the reported sigmas.
    ratio : scatter over reported.
    ratio_interval : 95 % chi-square interval of the ratio.
    coverage : coverage of one, two and three reported sigmas.
    bound : ``Bound.scatter`` of the parameter; None without a bound.
    pull : ``Bound.pull`` of the parameter; None without a bound.
    efficiency : variance of the bound over that of the estimates; None without a bound.
    efficiency_interval : 95 % interval of the efficiency.
    prior_share : ``Bound.prior_share`` of the parameter.
    """

    name: str
    unit: str
    reference: float
    bias: float
    bias_std: float
    scatter: float
    reported: float
    ratio: float
    ratio_interval: tuple[float, float]
    coverage: tuple[Within, ...]
    bound: float | None = None
    pull: float | None = None
    efficiency: float | None = None
    efficiency_interval: tuple[float, float] | None = None
    prior_share: float | None = None

    @property
    def two(self) -> Within:
        """Coverage within two sigmas."""
        return self.coverage[1]


@dataclass(frozen=True, eq=False)
class Squares:
    """NEES or NIS of each run: chi-square distributed if the sigmas are correct.

    Attributes
    ----------
    name : ``"NEES"`` or ``"NIS"``.
    values : sum of squares of each run, shape ``(M,)``.
    degrees : degrees of freedom of each run, shape ``(M,)``.
    mean : sum of values over sum of degrees of freedom.
    interval : contains the mean with 95 % probability if the sigmas are correct.
    inside : share of the runs within their own 95 % interval.
    inside_interval : exact 95 % interval of this share.
    """

    name: str
    values: np.ndarray
    degrees: np.ndarray
    mean: float
    interval: tuple[float, float]
    inside: float
    inside_interval: tuple[float, float]

    @property
    def right(self) -> bool:
        """Whether the mean agrees with correct sigmas."""
        return self.interval[0] <= self.mean <= self.interval[1]


@dataclass(frozen=True, eq=False)
class CampaignStatistics:
    """Statistics of a campaign.

    Attributes
    ----------
    parameters : statistics of each parameter.
    sigmas : errors of each run over its reported sigmas, shape ``(n, M)``.
    nees : normalized estimation error squared, or None.
    nis : normalized innovation squared; None for methods without innovations.
    """

    parameters: tuple[ParameterStatistics, ...]
    sigmas: np.ndarray
    nees: Squares | None
    nis: Squares | None

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(each.name for each in self.parameters)


def campaign_statistics(campaign: CampaignRuns) -> CampaignStatistics:
    """Return the statistics of the runs that converged, with the bound at the reference values."""
    bound = bound_of(campaign.work)
    reference = np.array([[spread.reference] for spread in campaign.spreads])
    parameters = tuple(
        _parameter(spread, campaign.values[i], campaign.std[i], bound, i)
        for i, spread in enumerate(campaign.spreads)
    )
    nees = squares("NEES", campaign.nees, np.full(len(campaign.nees), len(parameters)))
    return CampaignStatistics(
        parameters,
        (campaign.values - reference) / campaign.std,
        nees,
        squares("NIS", campaign.nis, campaign.degrees),
    )


def coverage_of(sigmas: np.ndarray) -> tuple[Within, ...]:
    """Return the coverage of one, two and three sigmas.

    ``sigmas``: errors over reported sigmas, shape ``(M,)``.
    """
    runs = len(sigmas)
    coverage = []
    for limit in SIGMAS:
        hits = int(np.sum(np.abs(sigmas) <= limit))
        coverage.append(Within(limit, hits, runs, hits / runs, clopper_pearson(hits, runs)))
    return tuple(coverage)


def squares(name: str, values: np.ndarray, degrees: np.ndarray) -> Squares | None:
    """Return the statistics of NEES or NIS over the runs that have it; None if no run has."""
    has_value = np.isfinite(values) & (degrees > 0)
    if not np.any(has_value):
        return None
    values, degrees = values[has_value], degrees[has_value]
    hits = int(np.sum(within_chi_square(values, degrees)))
    interval = mean_square_interval(float(degrees.sum()))
    return Squares(
        name,
        values,
        degrees,
        float(values.sum() / degrees.sum()),
        interval,
        hits / len(values),
        clopper_pearson(hits, len(values)),
    )


def _parameter(
    spread: Spread, values: np.ndarray, std: np.ndarray, bound: Bound | None, at: int
) -> ParameterStatistics:
    """Return the statistics of a parameter.

    ``values`` and ``std``: estimates and reported sigmas of the runs, shape ``(M,)``. ``at``: index
    of the parameter in the bound.
    """
    runs = len(values)
    low, high = deviation_factors(runs)
    ratio = spread.scatter / spread.reported if spread.reported > 0.0 else float("inf")
    coverage = coverage_of((values - spread.reference) / std)
    common = (
        spread.name,
        spread.unit,
        spread.reference,
        spread.bias,
        spread.scatter / runs**0.5,
        spread.scatter,
        spread.reported,
    )
    without_bound = ParameterStatistics(*common, ratio, (low * ratio, high * ratio), coverage)
    # Without a prior there is no bound if the record does not determine the parameter.
    if (
        bound is None
        or spread.scatter == 0.0
        or (np.isinf(bound.data[at]) and not bound.prior_share[at] > 0.0)
    ):
        return without_bound
    best = float(bound.scatter[at])
    efficiency = (best / spread.scatter) ** 2
    ends = efficiency / high**2, efficiency / low**2
    return ParameterStatistics(
        *common,
        ratio,
        (low * ratio, high * ratio),
        coverage,
        best,
        float(bound.pull[at]),
        efficiency,
        ends,
        float(bound.prior_share[at]),
    )


# ---- Content of campaign.json and statistics.csv


def statistics_content(statistics: CampaignStatistics) -> dict[str, Any]:
    """Return the content on each parameter, NEES and NIS; missing statistics are left out."""
    content: dict[str, Any] = {
        "parameters": {
            parameter.name: {
                key: value for key, value in _row_of(parameter).items() if value is not None
            }
            for parameter in statistics.parameters
        }
    }
    for squares in (statistics.nees, statistics.nis):
        if squares is not None:
            content[squares.name.lower()] = _squares_content(squares)
    return content


def statistics_csv(statistics: CampaignStatistics) -> str:
    """Return one CSV row per parameter, SI; missing values are empty."""
    rows = [_row_of(parameter) for parameter in statistics.parameters]
    return csv_text(rows[0], ([_cell_text(value) for value in row.values()] for row in rows))


def _cell_text(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else repr(value)


def _row_of(parameter: ParameterStatistics) -> dict[str, Any]:
    """Return the statistics of a parameter by their names in files; None if one is missing."""
    row: dict[str, Any] = {
        "parameter": parameter.name,
        "unit": parameter.unit,
        "runs": parameter.two.runs,
        "reference": parameter.reference,
    }
    row |= {
        "bias": parameter.bias,
        "bias_std": parameter.bias_std,
        "scatter": parameter.scatter,
        "reported_std": parameter.reported,
    }
    row |= {
        "ratio": _finite(parameter.ratio),
        "ratio_low": _finite(parameter.ratio_interval[0]),
        "ratio_high": _finite(parameter.ratio_interval[1]),
    }
    for share in parameter.coverage:
        row |= {
            f"within_{share.sigmas}": share.share,
            f"within_{share.sigmas}_low": share.interval[0],
            f"within_{share.sigmas}_high": share.interval[1],
        }
    low, high = parameter.efficiency_interval or (None, None)
    row |= {
        "bound_std": parameter.bound,
        "prior_pull": parameter.pull,
        "prior_share": parameter.prior_share,
    }
    return row | {
        "efficiency": parameter.efficiency,
        "efficiency_low": low,
        "efficiency_high": _finite(high),
    }


def _squares_content(squares: Squares) -> dict[str, Any]:
    return {
        "mean": squares.mean,
        "low": squares.interval[0],
        "high": squares.interval[1],
        "inside": squares.inside,
        "inside_low": squares.inside_interval[0],
        "inside_high": squares.inside_interval[1],
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
