"""Tests of residuals against noise, and of estimates against declared values and against each
other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.estimate import Estimate, FilterHistory
from ident.statistics.noise_levels import robust_sigma, robust_sigma_about_zero, with_constant_level
from sim.errors import ModelError
from sim.record import Record

# ---- Tests whether residuals are white noise

WHITENESS_P_VALUE = 1e-4  # residuals with a smaller p-value are not white noise
FAR_ABOVE = 2.0  # residuals with a larger ratio of rms to robust sigma have outliers
_FEWEST_SAMPLES = 10  # fewest samples of a test


@dataclass(frozen=True)
class ResidualTest:
    """Result of a test of residuals.

    Attributes
    ----------
    name : name of the test.
    channel : name of the tested output.
    statistic, p_value : statistic, and its p-value for white Gaussian noise.
    sentence : result in words.
    """

    name: str
    channel: str
    statistic: float
    p_value: float
    sentence: str

    @property
    def passed(self) -> bool:
        """Whether the p-value exceeds ``WHITENESS_P_VALUE``."""
        return self.p_value > WHITENESS_P_VALUE


def ljung_box(
    residual: np.ndarray, valid: np.ndarray, channel: str, lags: int = 25
) -> ResidualTest:
    """Return the Ljung-Box test of a ``residual (N,)`` for whiteness over ``lags`` lags (Ljung and
    Box, Biometrika 65(2), 1978). Missing samples are skipped.

    A noise level that changes along the series is divided out first (`with_constant_level`). The
    p-value is that of a shifted gamma distribution with the mean, variance and skewness of the
    statistic at this length. The limit, chi-square, rejects white noise of 300 samples seven times
    too often at 1e-4.
    """
    n = int(np.count_nonzero(valid))
    series = with_constant_level(residual[valid])
    series = series - (series.mean() if n else 0.0)
    lags = max(1, min(lags, n // 5))
    power = float(series @ series)
    if n < _FEWEST_SAMPLES or power == 0.0:
        return ResidualTest("ljung-box", channel, 0.0, 1.0, "too few samples to tell")
    r = np.array([series[lag:] @ series[: n - lag] for lag in range(1, lags + 1)]) / power
    statistic = float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))))
    p_value = _ljung_box_tail(statistic, lags, n)
    sentence = (
        f"{'white' if p_value > WHITENESS_P_VALUE else 'not white'} over {lags} lags, "
        f"lag-1 correlation {r[0]:.2f}"
    )
    return ResidualTest("ljung-box", channel, statistic, p_value, sentence)


def _ljung_box_tail(statistic: float, lags: int, n: int) -> float:
    """Return the probability that white noise of ``n`` samples has a larger statistic. The terms in
    lags/n are fitted to simulated noise of 60 to 3000 samples.
    """
    from scipy.special import chdtrc

    variance = 2.0 * lags * (1.0 + 1.8 * lags / n)
    skewness = np.sqrt(8.0 / lags) * (1.0 + 5.5 * lags / n)
    degrees = 8.0 / skewness**2
    scale = np.sqrt(variance / (2.0 * degrees))
    return float(chdtrc(degrees, max(0.0, (statistic - lags) / scale + degrees)))


def residual_size(residual: np.ndarray, valid: np.ndarray, channel: str) -> ResidualTest | None:
    """Return a failed test where a few samples of a ``residual (N,)`` are far larger than the
    others, else None. A test of whiteness does not detect such outliers.

    The rms is compared with the robust standard deviation from the median size. For Gaussian noise,
    the logarithm of their ratio has the standard deviation 0.93/sqrt(N).
    """
    from scipy.special import erfc

    series = with_constant_level(residual[valid])
    n = len(series)
    robust = robust_sigma_about_zero(series) if n >= _FEWEST_SAMPLES else 0.0
    ratio = float(np.sqrt(np.mean(series**2))) / robust if robust > 0.0 else 0.0
    if ratio < FAR_ABOVE:
        return None
    p_value = float(erfc(np.log(ratio) * np.sqrt(n / 2.0) / 0.93))
    shown = f"{ratio:.3g}" if ratio < 100.0 else f"{ratio:.0f}"
    return ResidualTest(
        "size",
        channel,
        ratio,
        p_value,
        f"large in parts of the record: rms {shown} times what it is in most of it",
    )


def innovation_size(history: FilterHistory) -> ResidualTest:
    """Return the two-sided chi-square test of the summed normalised innovation squared: whether the
    innovations are as large as the filter expects.
    """
    from scipy.special import chdtr, chdtrc

    total, degrees = float(history.nis.sum()), int(history.degrees.sum())
    if degrees == 0:
        return ResidualTest("nis", "all", 0.0, 1.0, "no sample was used")
    p_value = float(min(1.0, 2.0 * min(chdtr(degrees, total), chdtrc(degrees, total))))
    ratio = total / degrees
    return ResidualTest(
        "nis",
        "all",
        total,
        p_value,
        f"innovations are {np.sqrt(ratio):.3f} times the size that the filter expects",
    )


def tests_of_records(estimate: Estimate, records: Sequence[Record]) -> tuple[ResidualTest, ...]:
    """Return all tests of an estimate on its records. The residuals of all records are tested as
    one series.
    """
    measured = [record.output_array(estimate.output_names) for record in records]
    valid = np.concatenate([mask for _, mask in measured], axis=1)
    residuals = np.concatenate(
        [z - fitted for (z, _), fitted in zip(measured, estimate.fitted, strict=True)], axis=1
    )
    return residual_tests(estimate, np.where(valid, residuals, 0.0), valid)


def residual_tests(
    estimate: Estimate, residuals: np.ndarray, valid: np.ndarray
) -> tuple[ResidualTest, ...]:
    """Return all tests of an estimate. The innovations of a filter are tested, or else the
    ``residuals (m, N)`` of a whole-record fit with validity ``valid (m, N)``.
    """
    history = estimate.history
    if history is not None:
        residuals, valid = history.innovation / history.innovation_std, history.valid
    rows = list(zip(residuals, valid, estimate.output_names, strict=True))
    tests = [ljung_box(*row) for row in rows if np.any(row[1])]
    tests += [result for row in rows if (result := residual_size(*row)) is not None]
    return tuple(tests) if history is None else (*tests, innovation_size(history))


# ---- Plausibility of an estimate against its declared value

INTERVAL_SIGMAS = 2.0  # half-width of the interval of an estimate, in sigmas
# largest plausible ratio to the declared value: declared values may be 30 % wrong, and this is ten
# times as much
IMPLAUSIBLE_CHANGE_FACTOR = 3.0


def contradiction(value: float, std: float, declared: float) -> str:
    """Return a phrase on how an estimate contradicts its declared value, as in ``"has the other
    sign"``; empty if it does not.

    It contradicts where no value within two sigmas has the declared sign and less than three times
    the declared size. There is no contradiction where zero was declared, or where the value or the
    sigma is not finite.
    """
    if declared == 0.0 or not (math.isfinite(value) and math.isfinite(std) and std >= 0.0):
        return ""
    share, sigma = value / declared, abs(std / declared)
    if share + INTERVAL_SIGMAS * sigma < 0.0:
        return "has the other sign"
    if share - INTERVAL_SIGMAS * sigma > IMPLAUSIBLE_CHANGE_FACTOR:
        return f"is {share:.2g} times as large"
    return ""


def shortfall(value: float, std: float, declared: float) -> str:
    """Return a phrase on how much smaller an estimate is than its declared value, as in ``"is 12
    times smaller"``; empty if it is not much smaller.

    It is much smaller where no value within two sigmas reaches a third of the declared size.
    Constants of the vehicle file that are too large, such as the chord, make derivatives too small
    by the same factor. A value of the other sign is left to `contradiction`.
    """
    if declared == 0.0 or not (math.isfinite(value) and math.isfinite(std) and std >= 0.0):
        return ""
    share, sigma = value / declared, abs(std / declared)
    if (
        abs(share) + INTERVAL_SIGMAS * sigma >= 1.0 / IMPLAUSIBLE_CHANGE_FACTOR
        or share + INTERVAL_SIGMAS * sigma < 0.0
    ):
        return ""
    if share > INTERVAL_SIGMAS * sigma:
        return f"is {1.0 / share:.2g} times smaller"
    return "is not distinguishable from zero"


# ---- Share of the residuals that the inputs predict

# limits, s before a sample, of the intervals over which inputs are averaged
LAGS = (0.0, 0.06, 0.12, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2, 2.8)
RIDGE_SHARE = 0.01  # ridge of the regression, relative to the variance of a regressor
# smallest share of a residual that shows a missing response: in twelve flights of the rigid model
# with a delay of 60 ms it was 0.17 to 0.89, and at least 0.69 for one output; in turbulence it was
# below zero
MADE_BY_INPUTS = 0.3


def share_from_inputs(
    residuals: np.ndarray, valid: np.ndarray, inputs: np.ndarray, interval: float
) -> np.ndarray:
    """Return the share of each residual's power that the inputs predict.

    A regression on means of the inputs over intervals up to 2.8 s in the past is fitted to one half
    of the record and predicts the other half, and vice versa. It predicts residuals that come from
    a late or slow input or from a missing response. It does not predict residuals from rough air
    and noise: their share is near zero or negative. Slow residuals and inputs are correlated by
    chance. Therefore a moving average over 5.6 s is subtracted from both.

    Parameters
    ----------
    residuals : ``(m, N)`` measured minus fitted outputs.
    valid : ``(m, N)`` False where a sample is missing.
    inputs : ``(q, N)`` recorded inputs.
    interval : sampling interval, s.

    Returns
    -------
    Shares ``(m,)``, at most 1; zero for a residual that is zero.

    Examples
    --------
    >>> u = np.tile(np.repeat([0.0, 1.0, -1.0, 0.0], 50), 2)[None, :]
    >>> late = np.roll(u, 5, axis=1)
    >>> float(share_from_inputs(late - u, np.ones((1, 400), bool), u, 0.02)[0]) > 0.3
    True
    """
    count = residuals.shape[1]
    if count < 4 or not len(inputs):
        return np.zeros(len(residuals))
    residuals = _without_slow(np.where(valid, residuals, 0.0), interval)
    rows = _past_means(_without_slow(inputs, interval), interval)
    half = slice(0, count // 2), slice(count // 2, count)
    shares = np.zeros(len(residuals))
    for i, (residual, usable) in enumerate(zip(residuals, valid, strict=True)):
        series = np.where(
            usable, residual - (residual[usable].mean() if usable.any() else 0.0), 0.0
        )
        unexplained, total = 0.0, float(series @ series)
        for fitted, held in (half, half[::-1]):
            a = np.where(usable[fitted, None], rows[fitted], 0.0)
            ridge = RIDGE_SHARE * len(a) * np.eye(a.shape[1])
            weights = np.linalg.solve(a.T @ a + ridge, a.T @ series[fitted])
            unexplained += float(np.sum((series[held] - rows[held] @ weights)[usable[held]] ** 2))
        shares[i] = 1.0 - unexplained / total if total > 0.0 else 0.0
    return shares


def _without_slow(rows: np.ndarray, interval: float) -> np.ndarray:
    """Return ``rows (k, N)`` minus their moving averages over twice the longest lag."""
    from scipy.ndimage import uniform_filter1d

    size = min(max(round(2.0 * LAGS[-1] / interval), 1), rows.shape[1])
    return rows - uniform_filter1d(rows.astype(float), size, axis=1, mode="nearest")


def _past_means(inputs: np.ndarray, interval: float) -> np.ndarray:
    """Return the regressors ``(N, q * (len(LAGS) - 1))``: the means of each input over the past
    intervals between ``LAGS``, scaled to mean zero and variance one.
    """
    at = np.arange(1, inputs.shape[1] + 1)
    columns = []
    for row in inputs:
        area = np.concatenate([[0.0], np.cumsum(row - row[0]) * interval])
        for first, last in pairwise(round(lag / interval) for lag in LAGS):
            last = max(last, first + 1)
            columns.append(area[np.maximum(at - first, 0)] - area[np.maximum(at - last, 0)])
    rows = np.array(columns).T
    rows = rows - rows.mean(axis=0)
    scatter = rows.std(axis=0)
    return np.asarray(rows / np.where(scatter > 0.0, scatter, 1.0))


# ---- Comparison of two estimates

BOUND_SIGMAS = 2.0  # half-width of bounds in sigmas, as in NASA TM-101722


@dataclass(frozen=True)
class EstimateDifference:
    """Difference of one parameter between two estimates.

    Attributes
    ----------
    name, unit : name and unit of the parameter.
    first, second : values of the two estimates.
    first_std, second_std : their standard deviations.
    z : second minus first, over the root of the sum of both variances; zero where both variances
        are zero and the values are equal.
    beyond : whether |z| exceeds the limit of the comparison.
    """

    name: str
    unit: str
    first: float
    first_std: float
    second: float
    second_std: float
    z: float
    beyond: bool


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of two estimates from independent records.

    Attributes
    ----------
    differences : differences of the common parameters, the largest |z| first.
    statistic : d^T (P1 + P2)^-1 d of the vector d of all differences.
    degrees : degrees of freedom of the statistic.
    p_value : probability that two estimates of the same parameters differ by at least as much.
    """

    differences: tuple[EstimateDifference, ...]
    statistic: float
    degrees: int
    p_value: float

    @property
    def beyond(self) -> tuple[EstimateDifference, ...]:
        """Differences that exceed their uncertainty."""
        return tuple(item for item in self.differences if item.beyond)


def compare_estimates(first: Estimate, second: Estimate, limit: float = BOUND_SIGMAS) -> Comparison:
    """Compare two estimates parameter by parameter, and all parameters together with both
    covariances. A difference is significant where |z| exceeds ``limit``.

    Raises
    ------
    ModelError : where no parameter is common, or a common one has different units.
    """
    from scipy.special import chdtrc

    common = [name for name in first.names if name in second.names]
    if not common:
        raise ModelError(
            "no parameter in common",
            where="comparison of two estimates",
            remedy="compare estimates of one model",
        )
    a = [first.names.index(name) for name in common]
    b = [second.names.index(name) for name in common]
    for name, i, j in zip(common, a, b, strict=True):
        if first.units[i] != second.units[j]:
            what = f"one is in {first.units[i]}, the other in {second.units[j]}"
            raise ModelError(what, where=f"comparison, {name}", remedy="estimate both in one unit")
    d = second.values[b] - first.values[a]
    P = first.covariance[np.ix_(a, a)] + second.covariance[np.ix_(b, b)]
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    rows = []
    for k, name in enumerate(common):
        z = 0.0 if d[k] == 0 else float(np.copysign(1e9, d[k]))
        if scale[k] > 0:
            z = float(d[k] / scale[k])
        values = (first.value(name), first.sigma(name), second.value(name), second.sigma(name))
        rows.append(EstimateDifference(name, first.units[a[k]], *values, z, abs(z) > limit))
    usable = scale > 0
    whole = P[np.ix_(usable, usable)] / np.outer(scale[usable], scale[usable])
    white = d[usable] / scale[usable]
    statistic = float(white @ np.linalg.pinv(whole, hermitian=True) @ white)
    degrees = int(np.linalg.matrix_rank(whole, hermitian=True))
    ordered = tuple(sorted(rows, key=lambda item: -abs(item.z)))
    return Comparison(
        ordered, statistic, degrees, float(chdtrc(degrees, statistic)) if degrees else 1.0
    )


# ---- Tests whether noise is white below a few hertz, and equally large over the record

# Hz: short periods and first elastic modes of piloted aircraft have lower frequencies
LOW_FREQUENCY = 4.0


def flat_spectrum(
    residual: np.ndarray, valid: np.ndarray, time: np.ndarray, channel: str
) -> ResidualTest:
    """Return Bartlett's test of the cumulative periodogram: whether a ``residual (N,)`` is white
    below 4 Hz.

    Higher frequencies are left out, since the filters of recorders colour the noise there. Errors
    of a model appear at the frequencies of the motion. The p-value is Kolmogorov's with the
    correction of [1]_.

    References
    ----------
    .. [1] M. A. Stephens, "Use of the Kolmogorov-Smirnov, Cramer-von Mises and related statistics
       without extensive tables", Journal of the Royal Statistical Society B 32, 1970.
    """
    from scipy.special import kolmogorov

    series = np.zeros(len(residual))
    series[valid] = with_constant_level(residual[valid])
    n = len(series)
    interval = (time[-1] - time[0]) / (n - 1)
    power = np.abs(np.fft.rfft(series)) ** 2
    inside = np.fft.rfftfreq(n, interval) <= LOW_FREQUENCY
    inside[0] = False
    low_power = power[inside]
    k = len(low_power)
    if k < 8 or not low_power.sum() > 0.0:  # eight frequencies are the fewest for the test
        return ResidualTest("cumulative-periodogram", channel, 0.0, 1.0, "too short to tell")
    # For white noise the shares are k - 1 ordered uniform numbers.
    share = np.cumsum(low_power)[:-1] / low_power.sum()
    rank = np.arange(1, k)
    above, below = rank / (k - 1) - share, share - (rank - 1) / (k - 1)
    most = int(np.argmax(np.maximum(above, below)))
    distance = float(max(above[most], below[most]))
    # Stephens' correction for few numbers.
    root = np.sqrt(k - 1.0)
    p_value = float(kolmogorov((root + 0.12 + 0.11 / root) * distance))
    at = (most + 1) / (n * interval)
    sentence = (
        f"{100.0 * share[most]:.0f} % of the power below 4 Hz lies below {at:.2g} Hz, "
        f"of white noise {100.0 * (most + 1) / k:.0f} %"
    )
    return ResidualTest("cumulative-periodogram", channel, distance, p_value, sentence)


BURST_BLOCK = 0.5  # length of the blocks whose variances are compared, s


@dataclass(frozen=True)
class NoiseBurst:
    """Interval in which the residual of a channel is larger than in the rest of its record.

    Attributes
    ----------
    channel : name of the channel, as in residual tests.
    begin, end : limits of the interval, s.
    ratio : standard deviation in the interval over that of a median block.
    p_value : p-value of the loudest half second.
    """

    channel: str
    begin: float
    end: float
    ratio: float
    p_value: float


def largest_burst(residual: np.ndarray, time: np.ndarray, channel: str) -> NoiseBurst | None:
    """Return the interval around the half second in which a ``residual (N,)`` is largest; None
    where chance explains this half second.

    Variances of half seconds are compared with their median by the F distribution. Squares of
    filtered noise are correlated, which reduces the degrees of freedom.
    """
    from scipy.special import fdtrc

    size = max(10, round(BURST_BLOCK * (len(time) - 1) / (time[-1] - time[0])))
    count = len(residual) // size
    if count < 4:
        return None
    squares = ((residual - residual.mean()) ** 2)[: count * size].reshape(count, size)
    blocks = squares.mean(axis=1)
    # Degrees of freedom for correlated squares: from lag one within blocks, and from the robust
    # scatter of the logarithms (variance 2 over the degrees of freedom).
    around = squares / np.maximum(blocks[:, None], 1e-300) - 1.0
    alike = np.mean(around[:, 1:] * around[:, :-1]) / max(float(np.mean(around**2)), 1e-300)
    alike = np.clip(alike + 1.0 / size, 0.0, 0.9)
    scatter = robust_sigma(np.log(np.maximum(blocks, 1e-300)))
    freedom = min(size * (1.0 - alike) / (1.0 + alike), 2.0 / max(scatter**2, 1e-300))
    ratios = blocks / max(float(np.median(blocks)), 1e-300)
    p_values = np.minimum(1.0, count * fdtrc(freedom, freedom * count / 2.0, ratios))
    loudest = int(np.argmax(ratios))
    if not p_values[loudest] < WHITENESS_P_VALUE:
        return None
    first = last = loudest
    while first > 0 and p_values[first - 1] < 0.5:
        first -= 1
    while last < count - 1 and p_values[last + 1] < 0.5:
        last += 1
    return NoiseBurst(
        channel,
        float(time[first * size]),
        float(time[min((last + 1) * size, len(time)) - 1]),
        float(np.sqrt(ratios[first : last + 1].mean())),
        float(p_values[loudest]),
    )


# ---- Errors of a simulation


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of a simulation; each attribute maps the name of a channel to a figure.

    Attributes
    ----------
    rmse : root-mean-square error, in the unit of the channel.
    nrmse : the same over the standard deviation of the measured channel.
    r2 : coefficient of determination, R squared.
    theil : Theil's inequality coefficient.
    """

    rmse: Mapping[str, float]
    nrmse: Mapping[str, float]
    r2: Mapping[str, float]
    theil: Mapping[str, float]

    def fit_percent(self, channel: str) -> float:
        """Return 100 (1 - e), where e is the error of a channel over its standard deviation."""
        return 100.0 * (1.0 - self.nrmse[channel])


def error_figures(
    predictions: Sequence[np.ndarray],
    records: Sequence[Record],
    masks: Sequence[np.ndarray],
    channels: Sequence[str],
) -> ErrorFigures:
    """Return the errors of predicted channels over several records.

    Parameters
    ----------
    predictions : ``(m, N)`` of each record, in the order of ``channels``.
    masks : ``(m, N)`` of each record, False where a sample does not count.
    channels : names of the m outputs.
    """
    rmse, nrmse, r2, theil = {}, {}, {}, {}
    for i, name in enumerate(channels):
        pairs = [
            (p[i][mask[i]], record[name].values[mask[i]])
            for p, record, mask in zip(predictions, records, masks, strict=True)
            if name in record.output_names
        ]
        p, z = np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])
        if z.size == 0:
            continue
        error = float(np.sqrt(np.mean((z - p) ** 2)))
        spread = float(np.std(z))
        rmse[name] = error
        nrmse[name] = error / spread if spread > 0 else 0.0
        r2[name] = 1.0 - (error / spread) ** 2 if spread > 0 else 0.0
        size = float(np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(p**2)))
        theil[name] = error / size if size > 0 else 0.0
    return ErrorFigures(rmse, nrmse, r2, theil)
