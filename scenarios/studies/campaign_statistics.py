"""Statistics of a campaign's runs, the Cramer-Rao bound, and both in words and files.

A linear-Gaussian estimator with data information F and prior information P0 about theta0 has the
posterior covariance P = (F + P0)^-1 and the estimate P F theta_data + P P0 theta0. The prior is the
same for all records. The estimates therefore have the covariance P F P, smaller than P, and the
bias P P0 (theta0 - theta). A filter with several passes applies its prior in each pass.
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
    inside,
    inverse_information,
    mean_square_interval,
)
from ident.whole_record.layout import weighted_sensitivities
from scenarios.files.writing import csv_text
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    Block,
    Cell,
    Column,
    Number,
    Prose,
    known,
    table,
)
from scenarios.report.quantities import number_text, shown_in
from scenarios.studies.campaign import CampaignRuns, EstimatorRuns, Spread
from scenarios.studies.declaration import FILTERS, Estimation
from scenarios.studies.estimating import biased_system, compiled, filter_settings
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.errors import FlightidError
from sim.record import Record
from sim.truth.flight import Truth

# ---- Bound of an estimator with a method's priors on a campaign's flight

WIDE_PRIOR_FACTOR = 30.0  # widens priors until they add no information
_DIFFERENCE_STEP_SHARE = 1e-4  # step of finite differences, share of a parameter
_RESOLVED_SINGULAR_VALUE_SHARE = (
    1e-10  # share of the largest singular value that finite differences resolve
)


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramer-Rao bound at the reference values; ``(n,)`` in the parameters' units.

    Attributes
    ----------
    data : least standard deviation of an unbiased estimate without priors; infinite if the record
        does not determine the parameter.
    scatter : least standard deviation over runs of an estimate with the method's priors.
    pull : bias that these priors cause.
    stated : standard deviation that the estimate with priors reports.
    gain : ``(n, n)``, maps the scores ``slopes' residuals`` to estimates.
    slopes : ``(M, n)``, sensitivities in units of the noise, orthogonal to those of initial states
        and biases; None with process noise.
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
    try:
        if common.truth.process_density:
            data: np.ndarray | None = _forced(
                estimation, model.with_noise(noise), common.record, common.truth
            )
        else:
            slopes = _calm(estimation, model.with_noise(noise), common.record, names)
            data = slopes.T @ slopes
    except (FlightidError, np.linalg.LinAlgError):
        return None
    if data is None or not np.all(np.isfinite(data)):
        return None
    return replace(
        _with_priors(estimation, names, data, np.array([common.reference[name] for name in names])),
        slopes=slopes,
    )


def _calm(
    estimation: Estimation, model: Model, record: Record, names: tuple[str, ...]
) -> np.ndarray:
    """Return `Bound.slopes` of a record without process noise."""
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
    found, slopes = weighted_sensitivities(record, system, levels)
    return np.asarray(slopes[:, [found.index(name) for name in names]])


def _forced(
    estimation: Estimation, model: Model, record: Record, truth: Truth
) -> np.ndarray | None:
    """Return the information ``(n, n)`` with process noise.

    From a Kalman filter with the true noise levels on exact data, so that it stays linearised at
    the reference.
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
        outputs=tuple(replace(each, values=truth.outputs[each.name]) for each in record.outputs),
    )
    with_prior = replace(model, parameters=model.parameters.with_prior(prior))
    once = replace(estimation, method="ekf", passes=1)
    found = run_ekf(
        exact, compiled(once, with_prior), filter_settings(once), by=filter_batched
    ).only(free)
    information = np.linalg.inv(found.covariance) - np.diag(
        [prior[name] ** -2.0 for name in found.names]
    )
    order = [found.names.index(name) for name in free]
    return np.asarray(information[np.ix_(order, order)])


def _with_priors(
    estimation: Estimation, names: tuple[str, ...], data: np.ndarray, reference: np.ndarray
) -> Bound:
    alone, _ = inverse_information(data)
    alone_std = np.sqrt(np.diag(alone))
    prior = np.array([estimation.start[name].std for name in names])
    if estimation.method in FILTERS or estimation.use_priors:
        passes = estimation.passes if estimation.method in FILTERS else 1
        start = np.array([estimation.start[name].value for name in names])
        stated, gain, left = _passes(data, prior, passes, estimation.spread)
        scatter = np.sqrt(np.maximum(np.diag(gain @ data @ gain.T), 0.0))
        pull = left @ (start - reference)
    else:
        stated, scatter, pull, gain = alone_std, alone_std, np.zeros(len(names)), alone
    # A bound a thousand times the prior sigma is rounding error: the record leaves it open.
    open_ = alone_std > 1e3 * np.where(np.isfinite(prior), prior, np.inf)
    return Bound(names, np.where(open_, np.inf, alone_std), scatter, pull, stated, gain)


def _passes(
    data: np.ndarray, prior: np.ndarray, passes: int, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stated deviation ``(n,)`` after the last pass, and two gains ``(n, n)``.

    The gains multiply the scores of the data and the first start.
    """
    n, width = len(prior), prior
    gain, left, stated = np.zeros((n, n)), np.eye(n), prior
    for _ in range(passes):
        prior_information = np.diag(np.where(np.isfinite(width), width, np.inf) ** -2.0)
        covariance = inverse_information(data + prior_information)[0]
        gain, left = (
            covariance + covariance @ prior_information @ gain,
            covariance @ prior_information @ left,
        )
        stated = np.sqrt(np.diag(covariance))
        width = np.minimum(prior, spread * stated) if math.isfinite(spread) else prior
    return stated, gain, left


def cramer_rao(
    model: Model,
    again: Callable[[Model], Record],
    noise: Mapping[str, float],
    names: Sequence[str],
    biased: Mapping[str, float],
) -> Mapping[str, float]:
    """Return the Cramer-Rao bound (standard deviation) of parameters, one record, white noise.

    Sensitivities are central differences of simulated flights, independent of any estimator.
    Initial states and biases are unknown, too.

    Parameters
    ----------
    again : simulates a model without noise.
    noise : standard deviation by output.
    biased : prior standard deviation of the bias by output; may be infinite.
    """

    def outputs(changed: Model) -> np.ndarray:
        record = again(changed)
        return np.concatenate([record[name].values / std for name, std in noise.items()])

    def slope(moved: Callable[[float], Model], step: float) -> np.ndarray:
        return (outputs(moved(step)) - outputs(moved(-step))) / (2.0 * step)

    def valued(step: float, name: str) -> Model:
        return model.with_values({name: model.parameters[name].value + step})

    def started(step: float, name: str) -> Model:
        return model.with_initial(
            model.initial.with_values({name: model.initial[name].value + step})
        )

    columns = [
        slope(
            partial(valued, name=name),
            _DIFFERENCE_STEP_SHARE * (abs(model.parameters[name].value) or 1.0),
        )
        for name in names
    ]
    columns += [
        slope(
            partial(started, name=state.name), _DIFFERENCE_STEP_SHARE * max(abs(state.value), 1.0)
        )
        for state in model.initial
    ]
    count = len(columns[0]) // len(noise)
    columns += [
        np.repeat([(name == each) / std for each, std in noise.items()], count) for name in biased
    ]
    known = np.diag(
        [*np.zeros(len(columns) - len(biased)), *(1.0 / std for std in biased.values())]
    )
    jacobian = np.vstack([np.array(columns).T, known])
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = np.inf  # a state without effect on the outputs
    # From the slopes, not from their products, which lose half of the digits.
    inverse = np.linalg.pinv(jacobian / size, rcond=_RESOLVED_SINGULAR_VALUE_SHARE)
    return dict(
        zip(names, (np.linalg.norm(inverse, axis=1) / size)[: len(names)].tolist(), strict=True)
    )


# ---- Statistics of a campaign's runs: of each parameter, and of all together

SIGMAS = (1, 2, 3)
# Coverage of a normal distribution within 1, 2 and 3 standard deviations.
NORMAL = {1: 0.682689492137086, 2: 0.954499736103642, 3: 0.997300203936740}


@dataclass(frozen=True)
class Within:
    """Share of the runs whose interval of ``sigmas`` reported standard deviations holds the
    reference, with its exact 95 % interval.
    """

    sigmas: int
    hits: int
    runs: int
    share: float
    interval: tuple[float, float]

    @property
    def right(self) -> bool:
        """Whether the normal distribution's share lies in the interval."""
        return self.interval[0] <= NORMAL[self.sigmas] <= self.interval[1]


@dataclass(frozen=True, eq=False)
class ParameterStatistics:
    """One parameter over the sound runs, SI.

    Attributes
    ----------
    bias, bias_std : mean error and the standard deviation of that mean.
    scatter, reported : standard deviation of the estimates; root mean square of the reported
        sigmas.
    ratio, ratio_interval : scatter over reported, with its 95 % chi-square interval.
    coverage : within one, two and three reported sigmas.
    bound, pull : `Bound.scatter` and `Bound.pull` of this parameter; None without a bound.
    efficiency, efficiency_interval : variance of the bound over that of the estimates, with its
        interval.
    prior_share : see `Bound.prior_share`.
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
    """NEES or NIS of each run, which is chi-square distributed if the sigmas are correct.

    Attributes
    ----------
    values, degrees : ``(M,)``, sum of squares and degrees of freedom of each run.
    mean : over runs, of value over degrees.
    interval : contains the mean with 95 % probability if the sigmas are correct.
    inside, inside_interval : share of the runs within their own 95 % interval; its exact interval.
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
    """Statistics of all parameters.

    ``sigmas``: errors ``(n, M)`` in the sigmas that each run reports. ``nis``: None for methods
    without innovations.
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
    """Return the statistics of the sound runs, and the bound at the reference values."""
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
    """Return the shares of normalised errors ``(M,)`` within one, two and three sigmas."""
    runs = len(sigmas)
    hits = [int(np.sum(np.abs(sigmas) <= each)) for each in SIGMAS]
    return tuple(
        Within(each, hit, runs, hit / runs, clopper_pearson(hit, runs))
        for each, hit in zip(SIGMAS, hits, strict=True)
    )


def squares(name: str, values: np.ndarray, degrees: np.ndarray) -> Squares | None:
    """Return the statistics of NEES or NIS over the runs that have it; None if none has."""
    there = np.isfinite(values) & (degrees > 0)
    if not np.any(there):
        return None
    values, degrees = values[there], degrees[there]
    held = int(np.sum(inside(values, degrees)))
    interval = mean_square_interval(float(degrees.sum()))
    return Squares(
        name,
        values,
        degrees,
        float(values.sum() / degrees.sum()),
        interval,
        held / len(values),
        clopper_pearson(held, len(values)),
    )


def _parameter(
    spread: Spread, values: np.ndarray, std: np.ndarray, bound: Bound | None, at: int
) -> ParameterStatistics:
    runs = len(values)
    low, high = deviation_factors(runs)
    ratio = spread.scatter / spread.reported if spread.reported > 0.0 else float("inf")
    coverage = coverage_of((values - spread.reference) / std)
    ours = (
        spread.name,
        spread.unit,
        spread.reference,
        spread.bias,
        spread.scatter / runs**0.5,
        spread.scatter,
        spread.reported,
    )
    found = ParameterStatistics(*ours, ratio, (low * ratio, high * ratio), coverage)
    # No bound without a prior if the record leaves the parameter open.
    if (
        bound is None
        or spread.scatter == 0.0
        or (np.isinf(bound.data[at]) and not bound.prior_share[at] > 0.0)
    ):
        return found
    best = float(bound.scatter[at])
    efficiency = (best / spread.scatter) ** 2
    ends = efficiency / high**2, efficiency / low**2
    return ParameterStatistics(
        *ours,
        ratio,
        (low * ratio, high * ratio),
        coverage,
        best,
        float(bound.pull[at]),
        efficiency,
        ends,
        float(bound.prior_share[at]),
    )


# ---- Statistics of a campaign for campaign.json, and as statistics.csv


def statistics_content(found: CampaignStatistics) -> dict[str, Any]:
    """Return the statistics of each parameter and of NEES and NIS; missing ones are left out."""
    content: dict[str, Any] = {
        "parameters": {each.name: _content_parameter(each) for each in found.parameters}
    }
    return content | {
        each.name.lower(): _squares(each) for each in (found.nees, found.nis) if each is not None
    }


def statistics_csv(found: CampaignStatistics) -> str:
    """Return one CSV row per parameter, SI; missing values are empty."""
    rows = [_flat(each) for each in found.parameters]
    cells = (
        [
            each if isinstance(each, str) else "" if each is None else repr(each)
            for each in row.values()
        ]
        for row in rows
    )
    return csv_text(rows[0], cells)


def _content_parameter(each: ParameterStatistics) -> dict[str, Any]:
    return {key: value for key, value in _flat(each).items() if value is not None}


def _flat(each: ParameterStatistics) -> dict[str, Any]:
    row: dict[str, Any] = {
        "parameter": each.name,
        "unit": each.unit,
        "runs": each.two.runs,
        "reference": each.reference,
    }
    row |= {
        "bias": each.bias,
        "bias_std": each.bias_std,
        "scatter": each.scatter,
        "reported_std": each.reported,
    }
    row |= {
        "ratio": _finite(each.ratio),
        "ratio_low": _finite(each.ratio_interval[0]),
        "ratio_high": _finite(each.ratio_interval[1]),
    }
    for share in each.coverage:
        row |= {
            f"within_{share.sigmas}": share.share,
            f"within_{share.sigmas}_low": share.interval[0],
            f"within_{share.sigmas}_high": share.interval[1],
        }
    low, high = each.efficiency_interval or (None, None)
    row |= {"bound_std": each.bound, "prior_pull": each.pull, "prior_share": each.prior_share}
    return row | {
        "efficiency": each.efficiency,
        "efficiency_low": low,
        "efficiency_high": _finite(high),
    }


def _squares(each: Squares) -> dict[str, Any]:
    ends = {"low": each.interval[0], "high": each.interval[1]}
    return {
        "mean": each.mean,
        **ends,
        "inside": each.inside,
        "inside_low": each.inside_interval[0],
        "inside_high": each.inside_interval[1],
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


# ---- Statistics of a campaign in sentences

MEANINGS = {
    "NEES": "squared error in units of the reported covariance, all parameters together",
    "NIS": "squared innovation in units of its own",
}


def squares_sentence(squares: Squares) -> str:
    """Return the mean of NEES or NIS over its degrees of freedom, with its expected interval."""
    low, high = squares.interval
    sentence = (
        "as it should be" if squares.right else "too large" if squares.mean > high else "too small"
    )
    return (
        f"{squares.name} ({MEANINGS[squares.name]}) over its degrees of freedom: "
        f"{_near_one(squares.mean)}, {sentence} (correct sigmas give "
        f"{low:.3f} to {high:.3f} in 95 % of campaigns); {100 * squares.inside:.1f} % of the "
        "runs within their own 95 % interval"
    )


def _near_one(value: float) -> str:
    return f"{value:.3f}" if value < 100.0 else number_text(value)


# ---- Statistics of a campaign in tables

NOTE = (
    "Efficiency: variance of the Cramer-Rao bound at the reference over that of the estimates; 1 "
    "is the best possible. The bound includes the priors of the method. All intervals are at "
    "95 %: those of ratios by chi-square, those of shares by Clopper and Pearson."
)


def two_digits(value: float) -> Cell:
    """Return a deviation with two digits."""
    return Number(value, shown=number_text(value, value))


def statistics_blocks(found: CampaignStatistics) -> list[Block]:
    """Return the tables of scatter and bound, of coverage, and of NEES and NIS."""
    each = found.parameters
    names = (Column("parameter"), [p.name for p in each])
    shown = [(p, shown_in(p.unit, p.name)) for p in each]
    ends = [p.efficiency_interval or (None, None) for p in each]
    sizes = table(
        "scatter against the reported sigma and the Cramer-Rao bound",
        names,
        (
            Column("bias ± σ", BY_ROW, printed="bias"),
            [Number(s.factor * p.bias, s.factor * p.bias_std) for p, s in shown],
        ),
        (Column("scatter / reported", PURE), [known(p.ratio, 3) for p in each]),
        (Column("from", PURE), [known(p.ratio_interval[0], 3) for p in each]),
        (Column("to", PURE), [known(p.ratio_interval[1], 3) for p in each]),
        (
            Column("bound", BY_ROW),
            [MISSING if p.bound is None else two_digits(s.factor * p.bound) for p, s in shown],
        ),
        (Column("efficiency", PURE), [known(p.efficiency, 3) for p in each]),
        (Column("from", PURE), [known(low, 3) for low, _ in ends]),
        (Column("to", PURE), [known(high, 3) for _, high in ends]),
        units=[s.unit for _, s in shown],
    )
    shares: list[tuple[Column, list[Cell]]] = []
    for n in (1, 2, 3):
        covered = [p.coverage[n - 1] for p in each]
        parts = {
            f"within {n} σ": [within.share for within in covered],
            "from": [within.interval[0] for within in covered],
            "to": [within.interval[1] for within in covered],
        }
        for heading, values in parts.items():
            column = Column(heading, "%", printed=f"{heading.replace('σ', 'sigma')}, %")
            shares.append((column, [Number(100.0 * value, digits=1) for value in values]))
    covering = table(
        "share of the runs whose interval contains the reference (a normal distribution's: 68.3, "
        "95.4, 99.7 %)",
        names,
        *shares,
    )
    squares = [Prose(squares_sentence(s)) for s in (found.nees, found.nis) if s is not None]
    return [sizes, covering, Prose(NOTE, "note"), *squares]
