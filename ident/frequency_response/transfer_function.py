"""Transfer functions fitted to frequency responses: one, or several with shared poles.

The cost and its weights are those of Tischler and Remple, "Aircraft and Rotorcraft System
Identification", 2nd edition, AIAA 2012, chapter 11. The named forms of low-order equivalent systems
are those of MIL-STD-1797A, sections 4.2.1.2 and 4.5.1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.errors import ModelError

DELAY = "delay"
ACCEPTABLE_COST = 100.0  # cost below which a fit is acceptable (Tischler and Remple)
NEARLY_PERFECT_COST = 50.0  # cost below which a fit is nearly indistinguishable from the data
PHASE_WEIGHT = 0.01745  # one degree counts as 0.13 dB
_COST_FREQUENCIES = 20.0  # frequencies to which the cost is normalised
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)  # dB per unit of the natural logarithm of a gain
_DEGREES_PER_RADIAN = 180.0 / math.pi
_STARTING_DELAYS = (0.0, 0.03, 0.1, 0.25)  # s
# further starting delays, as shares of the group delay: the poles cause the remaining group delay
_GROUP_DELAY_SHARES = (0.5, 0.75, 1.0)
_START_ITERATIONS = 12  # linear least-squares iterations for a starting point
_MOST_EVALUATIONS = 300  # most evaluations of a search from one starting point
_HIGHEST_ORDER = 8
_LARGEST_ERROR = 1e6  # limit of a weighted error, so that the cost is finite
_RELATIVE_STEP, SMALLEST_SCALE = 1e-5, 1e-2  # of differences with respect to a parameter


@dataclass(frozen=True)
class Form:
    """Form of a transfer function ``numerator / denominator exp(-delay s)``.

    Attributes
    ----------
    name : ``"pitch"``, or ``"1/2"`` for the orders of numerator and denominator.
    orders : orders of numerator and denominator.
    parameters : names of all parameters, the delay last.
    poles : names of the parameters of the denominator.
    units : parameter -> unit. The unit of a gain is multiplied by the unit of the response.
    """

    name: str
    orders: tuple[int, int]
    parameters: tuple[str, ...]
    poles: tuple[str, ...]
    units: Mapping[str, str]

    def polynomials(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients of numerator and denominator, highest power first."""
        p = values
        if self.name == "roll":
            return np.array([p["gain"]]), np.array([1.0, p["inv_T_roll"]])
        if self.name == "pitch":
            numerator = p["gain"] * np.array([1.0, p["inv_T_theta2"]])
            return numerator, _second_order(p["frequency"], p["damping"])
        if self.name == "dutch-roll":
            return np.array([p["gain"]]), _second_order(p["frequency"], p["damping"])
        if self.name == "roll-and-dutch-roll":
            zeros = _second_order(p["numerator_frequency"], p["numerator_damping"])
            roll_mode = np.array([1.0, p["inv_T_roll"]])
            dutch_roll = _second_order(p["frequency"], p["damping"])
            return p["gain"] * zeros, np.polymul(roll_mode, dutch_roll)
        n, m = self.orders
        numerator = np.array([p[f"b{k}"] for k in range(n, -1, -1)])
        return numerator, np.array([1.0, *(p[f"a{k}"] for k in range(m - 1, -1, -1))])

    def response(self, values: Mapping[str, float], omega: np.ndarray) -> np.ndarray:
        """Return the complex response ``(F,)`` at ``omega``, rad/s."""
        numerator, denominator = self.polynomials(values)
        s = 1j * np.asarray(omega)
        ratio = np.polyval(numerator, s) / np.polyval(denominator, s)
        return np.asarray(ratio * np.exp(-s * values[DELAY]))

    def values_of(
        self, numerator: np.ndarray, denominator: np.ndarray, delay: float
    ) -> dict[str, float]:
        """Return the parameters of the form for two polynomials, highest power first, and a delay,
        s. If the form has a complex pair but the poles are real, frequency and damping are
        approximate.
        """
        numerator = np.asarray(numerator) / denominator[0]
        denominator = np.asarray(denominator) / denominator[0]
        values = {DELAY: delay}
        if self.name not in FORMS:
            values |= {f"b{k}": float(b) for k, b in enumerate(numerator[::-1])}
            return values | {f"a{k}": float(a) for k, a in enumerate(denominator[:0:-1])}
        values["gain"] = float(numerator[0])
        if "inv_T_roll" in self.parameters:
            roots = np.roots(denominator)
            real = roots[np.argmin(np.abs(roots.imag))].real
            values["inv_T_roll"] = float(-real)
            denominator = np.polydiv(denominator, [1.0, -real])[0]
        if "frequency" in self.parameters:
            values |= _frequency_and_damping(denominator, "")
        if "inv_T_theta2" in self.parameters:
            values["inv_T_theta2"] = float(numerator[1] / numerator[0])
        if "numerator_frequency" in self.parameters:
            values |= _frequency_and_damping(numerator / numerator[0], "numerator_")
        return values


def _second_order(frequency: float, damping: float) -> np.ndarray:
    """Return the coefficients of ``s^2 + 2 damping frequency s + frequency^2``."""
    return np.array([1.0, 2.0 * damping * frequency, frequency**2])


def _frequency_and_damping(coefficients: np.ndarray, prefix: str) -> dict[str, float]:
    """Return the parameters of a polynomial of second order; ``prefix`` begins their names."""
    frequency = math.sqrt(max(abs(float(coefficients[2])), 1e-8))
    damping = float(coefficients[1]) / (2.0 * frequency)
    return {f"{prefix}frequency": frequency, f"{prefix}damping": damping}


_UNITS = {
    "frequency": "rad/s",
    "numerator_frequency": "rad/s",
    "damping": "1",
    DELAY: "s",
    "numerator_damping": "1",
    "inv_T_roll": "1/s",
    "inv_T_theta2": "1/s",
}
_COMPLEX_PAIR = ("frequency", "damping")


def _named_form(
    name: str, orders: tuple[int, int], zeros: tuple[str, ...], poles: tuple[str, ...]
) -> Form:
    names = ("gain", *zeros, *poles, DELAY)
    units = {parameter: _UNITS.get(parameter, "") for parameter in names}
    units["gain"] = _per_seconds(orders[1] - orders[0])
    return Form(name, orders, names, poles, units)


def _per_seconds(power: int) -> str:
    """Return the unit ``1/s2`` for power 2, ``1/s`` for 1, and an empty text for 0."""
    if power == 0:
        return ""
    return "1/s" if power == 1 else f"1/s{power}"


FORMS: Mapping[str, Form] = {
    form.name: form
    for form in (
        _named_form("pitch", (1, 2), ("inv_T_theta2",), _COMPLEX_PAIR),
        _named_form("roll", (0, 1), (), ("inv_T_roll",)),
        _named_form("dutch-roll", (0, 2), (), _COMPLEX_PAIR),
        _named_form(
            "roll-and-dutch-roll",
            (2, 3),
            ("numerator_frequency", "numerator_damping"),
            ("inv_T_roll", *_COMPLEX_PAIR),
        ),
    )
}


def form_of(text: str) -> Form:
    """Return the form with a name of ``FORMS``, or with orders such as ``"1/2"``.

    Raises
    ------
    ModelError : for any other text.
    """
    if text in FORMS:
        return FORMS[text]
    match = re.fullmatch(r"([0-9]+)/([0-9]+)", text)
    if match is None:
        available = f"name {', '.join(FORMS)}, or orders such as 1/2"
        raise ModelError(f"there is no form {text!r}", where="fit", remedy=available)
    n, m = int(match[1]), int(match[2])
    if not 0 <= n <= m <= _HIGHEST_ORDER or m < 1:
        what = f"orders {n} and {m}"
        remedy = "the order of the denominator is 1 to 8, and not below that of the numerator"
        raise ModelError(what, where="fit", remedy=remedy)
    poles = tuple(f"a{k}" for k in range(m))
    zeros = tuple(f"b{k}" for k in range(n + 1))
    units = {DELAY: "s"}
    units |= {f"a{k}": _per_seconds(m - k) for k in range(m)}
    units |= {f"b{k}": _per_seconds(m - k) for k in range(n + 1)}
    return Form(text, (n, m), (*zeros, *poles, DELAY), poles, units)


@dataclass(frozen=True, eq=False)
class ResponseTarget:
    """A frequency response to fit.

    Attributes
    ----------
    name : name of the response.
    omega : ``(F,)`` frequencies, rad/s.
    response : ``(F,)`` complex response.
    coherence : ``(F,)`` coherence, partial coherence for several inputs.
    std : ``(F,)`` standard deviation of the real part, and of the imaginary part.
    length : length of the windows, s, one or ``(F,)``. Errors at frequencies nearer than about one
        over the length are correlated.
    """

    name: str
    omega: np.ndarray
    response: np.ndarray
    coherence: np.ndarray
    std: np.ndarray
    length: float | np.ndarray


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """A transfer function fitted to one response.

    Attributes
    ----------
    name : name of the response.
    form : form of the transfer function.
    values : parameter -> value, for all parameters.
    std : free parameter -> standard deviation.
    insensitivity : free parameter -> standard deviation if all others were known; never larger than
        ``std``.
    cost : Tischler's J.
    numerator, denominator : coefficients, highest power first.
    covariance : of the free parameters, in the order of ``std``.
    """

    name: str
    form: Form
    values: Mapping[str, float]
    std: Mapping[str, float]
    insensitivity: Mapping[str, float]
    cost: float
    numerator: np.ndarray
    denominator: np.ndarray
    covariance: np.ndarray

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Return the complex response ``(F,)`` at ``omega``, rad/s."""
        return self.form.response(self.values, omega)


@dataclass(frozen=True, eq=False)
class TransferFit:
    """Transfer functions fitted together.

    Attributes
    ----------
    functions : the transfer functions.
    cost : mean of their costs.
    shared : names of the parameters that all have in common.
    converged : whether the search ended at a minimum.
    """

    functions: tuple[FittedResponse, ...]
    cost: float
    shared: tuple[str, ...]
    converged: bool


def coherence_weight(coherence: np.ndarray) -> np.ndarray:
    """Return Tischler's weight ``(1.58 (1 - exp(-coherence)))^2`` of a squared error."""
    return np.asarray((1.58 * (1.0 - np.exp(-coherence))) ** 2)


def mismatch_cost(response: np.ndarray, model: np.ndarray, coherence: np.ndarray) -> float:
    """Return Tischler's cost: 20/F times the sum of the weighted squares of the errors in dB and
    degrees at F frequencies.
    """
    log_ratio = np.log(model / response)
    decibels = _DECIBELS_PER_NEPER * log_ratio.real
    degrees = _DEGREES_PER_RADIAN * log_ratio.imag
    squares = decibels**2 + PHASE_WEIGHT * degrees**2
    return float(_COST_FREQUENCIES * np.mean(coherence_weight(coherence) * squares))


def fit_transfer_functions(
    targets: Sequence[ResponseTarget],
    forms: Sequence[Form],
    fixed: Mapping[str, float] | None = None,
    *,
    shared_poles: bool = False,
) -> TransferFit:
    """Fit a transfer function to each response.

    Parameters
    ----------
    targets : the responses.
    forms : the form of the transfer function of each response.
    fixed : parameter -> value, held in every form that has the parameter.
    shared_poles : whether the parameters of the denominators are common to all responses.

    Raises
    ------
    ModelError : if no form has a fixed parameter, if no parameter is free, if there are fewer
        numbers than parameters, or if forms with shared poles have different denominators.
    """
    fixed = dict(fixed or {})
    parameters = dict.fromkeys(name for form in forms for name in form.parameters)
    for name, value in fixed.items():
        if name not in parameters:
            what, remedy = f"no form has a parameter {name!r}", ", ".join(parameters)
            raise ModelError(what, where="fix", remedy=f"the parameters are {remedy}")
        if not math.isfinite(value):
            what = f"{name} = {value} is not finite"
            raise ModelError(what, where="fix", remedy="give a finite number")
        if name == DELAY and value < 0.0:
            what = f"a delay of {value:g} s"
            raise ModelError(what, where="fix", remedy="give a delay of zero or more")
    if shared_poles and any(form.poles != forms[0].poles for form in forms):
        what = "the denominators have different parameters"
        raise ModelError(what, where="shared poles", remedy="give forms with the same denominator")
    shared = tuple(name for name in forms[0].poles if shared_poles and len(forms) > 1)
    # function, 0 for a shared parameter, and name of each free parameter
    keys: list[tuple[int, str]] = []
    for n, form in enumerate(forms):
        keys += [
            (n, name)
            for name in form.parameters
            if name not in fixed and not (name in shared and n > 0)
        ]
    count = 2 * sum(target.omega.size for target in targets)
    if not keys or count <= len(keys):
        what = "nothing is free" if not keys else f"{len(keys)} free parameters for {count} numbers"
        raise ModelError(what, where="fit", remedy="free a parameter, or widen the usable band")
    starts = [_starts(target, form, fixed) for target, form in zip(targets, forms, strict=True)]
    problem = _Problem(tuple(targets), tuple(forms), fixed, shared, tuple(keys))
    best, converged = problem.minimum(starts)
    return problem.result(best, converged)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Weighted least squares over the free parameters ``p (q,)`` of all transfer functions.

    ``keys`` has the function, 0 for a shared parameter, and the name of each free parameter.
    """

    targets: tuple[ResponseTarget, ...]
    forms: tuple[Form, ...]
    fixed: Mapping[str, float]
    shared: tuple[str, ...]
    keys: tuple[tuple[int, str], ...]

    def values(self, p: np.ndarray) -> list[dict[str, float]]:
        """Return parameter -> value for each function."""
        free = dict(zip(self.keys, p.tolist(), strict=True))
        return [
            {
                name: self.fixed[name] if name in self.fixed else free[self._key(n, name)]
                for name in form.parameters
            }
            for n, form in enumerate(self.forms)
        ]

    def _key(self, n: int, name: str) -> tuple[int, str]:
        """Return the key of a free parameter of function ``n``."""
        return (0 if name in self.shared else n, name)

    def residuals(self, p: np.ndarray) -> np.ndarray:
        """Return the `weighted_errors` of the functions."""
        with np.errstate(all="ignore"):
            functions = zip(self.forms, self.values(p), self.targets, strict=True)
            log_ratios = [
                np.log(form.response(values, target.omega) / target.response)
                for form, values, target in functions
            ]
            return weighted_errors(self.targets, log_ratios)

    def minimum(self, starts: Sequence[Sequence[Mapping[str, float]]]) -> tuple[np.ndarray, bool]:
        """Return the parameters of least cost by searches from all starts, and whether the search
        that found them converged. ``starts`` has the same number of starts for each function.
        """
        from scipy.optimize import least_squares

        best, least, converged = np.zeros(len(self.keys)), math.inf, False
        positive = [name in (DELAY, "inv_T_roll") or "frequency" in name for _, name in self.keys]
        low = np.where(positive, 0.0, -np.inf)
        for start in zip(*starts, strict=True):
            p = np.array([start[n][name] for n, name in self.keys])
            p = np.maximum(p, np.where(np.isfinite(low), low + 1e-6, p))
            scale, most = np.maximum(np.abs(p), SMALLEST_SCALE), _MOST_EVALUATIONS
            solution = least_squares(
                self.residuals, p, bounds=(low, np.inf), x_scale=scale, max_nfev=most
            )
            if solution.cost < least:
                best, least, converged = solution.x, float(solution.cost), solution.status > 0
        return best, converged

    def result(self, p: np.ndarray, converged: bool) -> TransferFit:
        """Return the fit with standard deviations from the errors of the responses."""
        slopes = central_slopes(self.residuals, p)
        normal = slopes.T @ slopes
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scales = np.outer(scale, scale)
        inverse = np.linalg.pinv(normal / scales, rcond=1e-12) / scales
        gains = inverse @ slopes.T
        covariance = gains @ weighted_noise(self.targets) @ gains.T
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        conditional = conditional_std(covariance)
        values = self.values(p)
        functions = []
        for n, (target, form) in enumerate(zip(self.targets, self.forms, strict=True)):
            place = {
                name: self.keys.index(self._key(n, name))
                for name in form.parameters
                if name not in self.fixed
            }
            rows = list(place.values())
            model = form.response(values[n], target.omega)
            functions.append(
                FittedResponse(
                    target.name,
                    form,
                    values[n],
                    {name: float(std[i]) for name, i in place.items()},
                    {name: float(conditional[i]) for name, i in place.items()},
                    mismatch_cost(target.response, model, target.coherence),
                    *form.polynomials(values[n]),
                    covariance[np.ix_(rows, rows)],
                )
            )
        cost = float(np.mean([function.cost for function in functions]))
        return TransferFit(tuple(functions), cost, self.shared, converged)


def central_slopes(residuals: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    """Return the derivatives ``(R, q)`` of residuals at ``p (q,)`` by central differences."""
    columns = []
    for k, value in enumerate(p):
        step = _RELATIVE_STEP * max(abs(value), SMALLEST_SCALE)
        above, below = p.copy(), p.copy()
        above[k] += step
        below[k] -= step
        columns.append((residuals(above) - residuals(below)) / (2.0 * step))
    return np.array(columns).T


def conditional_std(covariance: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each of q parameters if all others were known, ``(q,)``.

    It is 1/sqrt((C^-1)_ii), from the covariance C ``(q, q)``, and never larger than sqrt(C_ii).
    Tischler's insensitivity 1/sqrt(H_ii) has the Hessian H in the place of C^-1.

    Examples
    --------
    >>> import numpy as np
    >>> conditional_std(np.array([[4.0, 0.0], [0.0, 9.0]])).tolist()
    [2.0, 3.0]
    >>> conditional_std(np.array([[1.0, 0.6], [0.6, 1.0]])).round(6).tolist()
    [0.8, 0.8]
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(std > 0.0, std, 1.0)
    inverse = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    # The diagonal of the pseudo-inverse of a singular C may be below one.
    return np.asarray(std / np.sqrt(np.maximum(np.diag(inverse), 1.0)))


def weighted_errors(targets: Sequence[ResponseTarget], ratios: Sequence[np.ndarray]) -> np.ndarray:
    """Return the weighted errors of all targets, those in dB before those in degrees for each
    target. The sum of their squares is the sum of the costs.

    ``ratios`` are the natural logarithms ``(F,)`` of model over response.
    """
    errors = []
    for target, ratio in zip(targets, ratios, strict=True):
        root = np.sqrt(coherence_weight(target.coherence) * _COST_FREQUENCIES / target.omega.size)
        errors.append(_DECIBELS_PER_NEPER * root * ratio.real)
        errors.append(math.sqrt(PHASE_WEIGHT) * _DEGREES_PER_RADIAN * root * ratio.imag)
    all_errors = np.concatenate(errors)
    limited = np.clip(all_errors, -_LARGEST_ERROR, _LARGEST_ERROR)
    return np.where(np.isfinite(all_errors), limited, _LARGEST_ERROR)


def weighted_noise(targets: Sequence[ResponseTarget]) -> np.ndarray:
    """Return the covariance ``(R, R)`` of `weighted_errors`. Errors of one response at neighbouring
    frequencies are correlated (`shared_correlation`).
    """
    sizes = [target.omega.size for target in targets]
    covariance = np.zeros((2 * sum(sizes), 2 * sum(sizes)))
    begin = 0
    for target, size in zip(targets, sizes, strict=True):
        root = np.sqrt(coherence_weight(target.coherence) * _COST_FREQUENCIES / size)
        relative_std = target.std / np.abs(target.response)
        correlation = shared_correlation(target.omega, target.length)
        for factor in (_DECIBELS_PER_NEPER, math.sqrt(PHASE_WEIGHT) * _DEGREES_PER_RADIAN):
            std = factor * root * relative_std
            rows = slice(begin, begin + size)
            covariance[rows, rows] = correlation * np.outer(std, std)
            begin += size
    return covariance


def shared_correlation(omega: np.ndarray, length: float | np.ndarray) -> np.ndarray:
    """Return the correlation ``(F, F)`` of the errors of a response at frequencies ``omega``,
    rad/s, from windows of ``length``, s, one or ``(F,)``. Short windows correlate wider bands.
    """
    frequency_difference = np.subtract.outer(omega, omega) / (2.0 * math.pi)
    return neighbour_correlation(frequency_difference * 0.5 * np.add.outer(length, length))


def neighbour_correlation(bins: np.ndarray) -> np.ndarray:
    """Return the correlation of the errors of a response at two frequencies, for Hann windows.

    ``bins`` is the difference of the frequencies times the length of the windows. The correlation
    is the squared Fourier transform of the squared window.
    """
    x = np.asarray(bins, dtype=float)
    # hann^2 = 3/8 - cos(u)/2 + cos(2 u)/8, and cos(k u) shifts a sinc by k bins
    transform = 0.375 * np.sinc(x) + 0.25 * (np.sinc(x - 1.0) + np.sinc(x + 1.0))
    transform += 0.0625 * (np.sinc(x - 2.0) + np.sinc(x + 2.0))
    return np.asarray((transform / 0.375) ** 2)


def _starts(
    target: ResponseTarget, form: Form, fixed: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return the starting values of all parameters for several delays.

    They follow from iterated linear least squares (Sanathanan and Koerner, IEEE Trans. Automatic
    Control 8(1), 1963).
    """
    group_delay, s = _group_delay(target), 1j * target.omega
    delays = (*_STARTING_DELAYS, *(share * group_delay for share in _GROUP_DELAY_SHARES))
    starts = []
    for delay in (fixed.get(DELAY, delay) for delay in delays):
        undelayed = target.response * np.exp(s * delay)
        scale = float(np.exp(np.mean(np.log(target.omega))))
        z = s / scale
        n, m = form.orders
        denominator = np.ones(s.size, dtype=complex)
        weight = np.sqrt(coherence_weight(target.coherence)) / np.abs(undelayed)
        coefficients = np.zeros(n + m + 1)
        for _ in range(_START_ITERATIONS):
            rows = [z**k for k in range(n + 1)] + [-undelayed * z**k for k in range(m)]
            regressors = (np.array(rows) * weight / np.abs(denominator)).T
            dependent = undelayed * z**m * weight / np.abs(denominator)
            coefficients = np.linalg.lstsq(
                np.concatenate([regressors.real, regressors.imag]),
                np.concatenate([dependent.real, dependent.imag]),
                rcond=None,
            )[0]
            denominator = z**m + np.array([z**k for k in range(m)]).T @ coefficients[n + 1 :]
        b = [coefficients[k] * scale ** (m - k) for k in range(n, -1, -1)]
        a = [1.0, *(coefficients[n + 1 + k] * scale ** (m - k) for k in range(m - 1, -1, -1))]
        starts.append(form.values_of(np.array(b), np.array(a), delay) | dict(fixed))
    return starts


def _group_delay(target: ResponseTarget) -> float:
    """Return minus the slope of the phase in the upper half of the band, s, at least zero."""
    upper = target.omega >= 0.5 * target.omega[-1]
    if np.count_nonzero(upper) < 2:
        return 0.0
    slope = np.polyfit(target.omega[upper], np.unwrap(np.angle(target.response[upper])), 1)[0]
    return max(float(-slope), 0.0)


# ---- Envelopes of added dynamics that pilots do not notice


@dataclass(frozen=True, eq=False)
class Envelopes:
    """Envelopes of maximum unnoticeable added dynamics, ``(F,)`` each, in dB and deg."""

    low_gain: np.ndarray
    high_gain: np.ndarray
    low_phase: np.ndarray
    high_phase: np.ndarray


PILOT_BAND = (0.1, 10.0)  # rad/s, frequencies of a pilot's control, at which the envelopes apply
# Numerator and denominator in s, highest power first, of the lower and upper curve, by Hodgkinson
# and Wood (McDonnell Douglas), as in MIL-STD-1797A. Some prints also have short delays in the phase
# curves, which widen the envelope by up to 4 deg at 10 rad/s.
_GAINS = (([0.0955, 9.92, 2.15], [1.0, 11.60, 4.95]), ([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]))
_PHASES = (
    ([475.32, 184100.0, 29460.0], [1.0, 11.66, 0.0389]),
    ([68.89, 1100.12, -275.22], [1.0, 39.94, 9.99]),
)


def unnoticeable_envelopes(omega: np.ndarray) -> Envelopes:
    """Return the envelopes of added dynamics that pilots do not notice, at ``omega``, rad/s.

    Wood and Hodgkinson, "Definition of Acceptable Levels of Mismatch for Equivalent Systems of
    Augmented CTOL Aircraft", MDC A6792, McDonnell Douglas 1980; MIL-STD-1797A.
    """
    s = 1j * np.asarray(omega)

    def curve(numerator: list[float], denominator: list[float]) -> np.ndarray:
        return np.asarray(np.polyval(numerator, s) / np.polyval(denominator, s))

    gains = [20.0 * np.log10(np.abs(curve(*polynomials))) for polynomials in _GAINS]
    phases = [np.degrees(np.angle(curve(*polynomials))) for polynomials in _PHASES]
    return Envelopes(gains[0], gains[1], phases[0], phases[1])
