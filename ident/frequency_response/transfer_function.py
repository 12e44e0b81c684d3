"""Transfer functions fitted to frequency responses, one or several with shared poles.

Cost and weights: Tischler and Remple, "Aircraft and Rotorcraft System Identification", 2nd edition,
AIAA 2012, chapter 11. Named forms of low-order equivalent systems: MIL-STD-1797A, sections 4.2.1.2
and 4.5.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.errors import ModelError

DELAY = "delay"
ACCEPTABLE_COST = 100.0  # cost below which a fit is acceptable (Tischler and Remple)
NEARLY_PERFECT_COST = 50.0  # cost below which a fit is nearly indistinguishable from the data
PHASE_WEIGHT = 0.01745  # one degree counts as 0.13 dB
_COST_FREQUENCIES = 20.0  # frequencies to which the cost is normalised
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)  # dB per unit of the natural logarithm of a gain
_DEGREES_PER_RADIAN = 180.0 / math.pi  # deg in a rad
_DELAYS = (0.0, 0.03, 0.1, 0.25)  # s, from which the search starts
_SHARES = (0.5, 0.75, 1.0)  # starting delays, relative to the group delay; the poles give the rest
_START_ITERATIONS = 12  # linear iterations for a start


@dataclass(frozen=True)
class Form:
    """A form of a transfer function ``numerator / denominator exp(-delay s)``.

    Attributes
    ----------
    name : ``"pitch"``, or ``"1/2"`` for orders of numerator and denominator.
    orders : of numerator and denominator.
    parameters : names of the parameters, the delay last.
    poles : those of the denominator.
    units : by parameter; of the gain those of the response times a power of 1/s.
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
            top = p["gain"] * np.array([1.0, p["inv_T_theta2"]])
            return top, _pair(p["frequency"], p["damping"])
        if self.name == "dutch-roll":
            return np.array([p["gain"]]), _pair(p["frequency"], p["damping"])
        if self.name == "roll-and-dutch-roll":
            top = p["gain"] * _pair(p["numerator_frequency"], p["numerator_damping"])
            lag = np.array([1.0, p["inv_T_roll"]])
            return top, np.polymul(lag, _pair(p["frequency"], p["damping"]))
        top = np.array([p[f"b{n}"] for n in range(self.orders[0], -1, -1)])
        return top, np.array([1.0, *(p[f"a{n}"] for n in range(self.orders[1] - 1, -1, -1))])

    def response(self, values: Mapping[str, float], omega: np.ndarray) -> np.ndarray:
        """Complex response at ``omega``, rad/s."""
        top, bottom = self.polynomials(values)
        s = 1j * np.asarray(omega)
        return np.asarray(np.polyval(top, s) / np.polyval(bottom, s) * np.exp(-s * values[DELAY]))

    def values_of(self, top: np.ndarray, bottom: np.ndarray, delay: float) -> dict[str, float]:
        """Return the parameters of polynomials of these orders, as far as they have the form."""
        bottom, top = np.asarray(bottom) / bottom[0], np.asarray(top) / bottom[0]
        out = {DELAY: delay}
        if self.name not in FORMS:
            out |= {f"b{n}": float(each) for n, each in enumerate(top[::-1])}
            return out | {f"a{n}": float(each) for n, each in enumerate(bottom[:0:-1])}
        out["gain"] = float(top[0])
        if "inv_T_roll" in self.parameters:
            roots = np.roots(bottom)
            real = roots[np.argmin(np.abs(roots.imag))].real
            out["inv_T_roll"] = float(-real)
            bottom = np.polydiv(bottom, [1.0, -real])[0]
        if "frequency" in self.parameters:
            out |= _of_pair(bottom, "")
        if "inv_T_theta2" in self.parameters:
            out["inv_T_theta2"] = float(top[1] / top[0])
        if "numerator_frequency" in self.parameters:
            out |= _of_pair(top / top[0], "numerator_")
        return out


def _pair(frequency: float, damping: float) -> np.ndarray:
    return np.array([1.0, 2.0 * damping * frequency, frequency**2])


def _of_pair(coefficients: np.ndarray, prefix: str) -> dict[str, float]:
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
_PAIR = ("frequency", "damping")


def _named(
    name: str, orders: tuple[int, int], zeros: tuple[str, ...], poles: tuple[str, ...]
) -> Form:
    names = ("gain", *zeros, *poles, DELAY)
    units = {each: _UNITS.get(each, "") for each in names}
    return Form(name, orders, names, poles, units | {"gain": _per_seconds(orders[1] - orders[0])})


def _per_seconds(power: int) -> str:
    """``1/s2``, the unit of a coefficient beside that of output over input."""
    return "" if power == 0 else "1/s" if power == 1 else f"1/s{power}"


FORMS: Mapping[str, Form] = {
    form.name: form
    for form in (
        _named("pitch", (1, 2), ("inv_T_theta2",), _PAIR),
        _named("roll", (0, 1), (), ("inv_T_roll",)),
        _named("dutch-roll", (0, 2), (), _PAIR),
        _named(
            "roll-and-dutch-roll",
            (2, 3),
            ("numerator_frequency", "numerator_damping"),
            ("inv_T_roll", *_PAIR),
        ),
    )
}


def form_of(text: str) -> Form:
    """Return a named form, or the orders ``"1/2"`` of numerator and denominator.

    Raises ModelError for anything else.
    """
    if text in FORMS:
        return FORMS[text]
    top, slash, bottom = text.partition("/")
    available = f"name {', '.join(FORMS)}, or orders such as 1/2"
    if not (slash and top.isascii() and top.isdigit() and bottom.isascii() and bottom.isdigit()):
        raise ModelError(f"there is no form {text!r}", where="fit", remedy=available)
    n, m = int(top), int(bottom)
    if not 0 <= n <= m <= 8 or m < 1:
        what = f"orders {n} and {m}"
        raise ModelError(what, where="fit", remedy="the denominator has the higher one, 1 to 8")
    poles = tuple(f"a{k}" for k in range(m))
    names = (*(f"b{k}" for k in range(n + 1)), *poles, DELAY)
    return Form(
        text,
        (n, m),
        names,
        poles,
        {
            DELAY: "s",
            **{f"a{k}": _per_seconds(m - k) for k in range(m)},
            **{f"b{k}": _per_seconds(m - k) for k in range(n + 1)},
        },
    )


@dataclass(frozen=True, eq=False)
class ResponseTarget:
    """A frequency response to fit.

    Attributes
    ----------
    name : of the response.
    omega : rad/s, ``(F,)``.
    response : complex ``(F,)``.
    coherence : ``(F,)``, partial where there are several inputs.
    std : ``(F,)``, of real and imaginary part.
    length : s, of the windows, one or ``(F,)``: over which frequencies errors are correlated.
    """

    name: str
    omega: np.ndarray
    response: np.ndarray
    coherence: np.ndarray
    std: np.ndarray
    length: float | np.ndarray


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """A transfer function of one response.

    Attributes
    ----------
    name : of the response.
    form : of the function.
    values : all parameters.
    std, insensitivity : standard deviation of the free ones, and with all others known, which is
        never more.
    cost : Tischler's J.
    numerator, denominator : highest power first.
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
        """Complex response at ``omega``, rad/s."""
        return self.form.response(self.values, omega)


@dataclass(frozen=True, eq=False)
class TransferFit:
    """Transfer functions fitted together. ``cost``: the mean of theirs. ``shared``: names of the
    parameters that are common. ``converged``: whether the search ended at a minimum."""

    functions: tuple[FittedResponse, ...]
    cost: float
    shared: tuple[str, ...]
    converged: bool


def coherence_weight(coherence: np.ndarray) -> np.ndarray:
    """Tischler's weight ``(1.58 (1 - exp(-coherence)))^2`` of a squared error."""
    return np.asarray((1.58 * (1.0 - np.exp(-coherence))) ** 2)


def mismatch_cost(response: np.ndarray, model: np.ndarray, coherence: np.ndarray) -> float:
    """Tischler's cost: 20/n of the sum of the weighted squares of errors in dB and degrees."""
    ratio = np.log(model / response)
    squares = (_DECIBELS_PER_NEPER * ratio.real) ** 2 + PHASE_WEIGHT * (
        _DEGREES_PER_RADIAN * ratio.imag
    ) ** 2
    return float(_COST_FREQUENCIES * np.mean(coherence_weight(coherence) * squares))


def fit_transfer_functions(
    targets: Sequence[ResponseTarget],
    forms: Sequence[Form],
    fixed: Mapping[str, float] | None = None,
    *,
    shared_poles: bool = False,
) -> TransferFit:
    """Fit a transfer function to each response, together where poles are shared.

    Parameters
    ----------
    targets, forms : of the same number.
    fixed : parameter -> value, in every form that has it.
    shared_poles : the parameters of the denominators are common to all.

    Raises
    ------
    ModelError : a fixed parameter that no form has, all fixed, fewer points than parameters,
        denominators that differ where they are shared.
    """
    fixed = dict(fixed or {})
    every = [name for form in forms for name in form.parameters]
    for name, value in fixed.items():
        if name not in every or not math.isfinite(value):
            available = ", ".join(dict.fromkeys(every))
            if name not in every:
                what, remedy = (
                    f"no form has a parameter {name!r}",
                    f"the parameters are {available}",
                )
            else:
                what, remedy = f"{name} = {value} is not finite", "give a finite number"
            raise ModelError(what, where="fix", remedy=remedy)
        if name == DELAY and value < 0.0:
            what = f"a delay of {value:g} s"
            raise ModelError(what, where="fix", remedy="give a delay of zero or more")
    if shared_poles and any(form.poles != forms[0].poles for form in forms):
        what = "the denominators have different parameters"
        raise ModelError(what, where="shared poles", remedy="give forms with the same denominator")
    shared = tuple(name for name in forms[0].poles if shared_poles and len(forms) > 1)
    keys: list[tuple[int, str]] = []  # of each free number: the function (0 where shared), the name
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
    starts = [_start(target, form, fixed) for target, form in zip(targets, forms, strict=True)]
    problem = _Problem(tuple(targets), tuple(forms), fixed, shared, tuple(keys))
    best, converged = problem.searched(starts)
    return problem.told(best, converged)


@dataclass(frozen=True, eq=False)
class _Problem:
    targets: tuple[ResponseTarget, ...]
    forms: tuple[Form, ...]
    fixed: Mapping[str, float]
    shared: tuple[str, ...]
    keys: tuple[tuple[int, str], ...]

    def values(self, p: np.ndarray) -> list[dict[str, float]]:
        """Return the parameters of each function."""
        free = dict(zip(self.keys, p.tolist(), strict=True))
        return [
            {
                name: self.fixed[name]
                if name in self.fixed
                else free[(0 if name in self.shared else n, name)]
                for name in form.parameters
            }
            for n, form in enumerate(self.forms)
        ]

    def ratios(self, p: np.ndarray) -> list[np.ndarray]:
        """Logarithms of model over response."""
        return [
            np.log(form.response(values, target.omega) / target.response)
            for form, values, target in zip(self.forms, self.values(p), self.targets, strict=True)
        ]

    def residuals(self, p: np.ndarray) -> np.ndarray:
        """Weighted errors whose squares sum to the sum of the costs."""
        with np.errstate(all="ignore"):
            return weighted_errors(self.targets, self.ratios(p))

    def searched(self, starts: Sequence[Sequence[Mapping[str, float]]]) -> tuple[np.ndarray, bool]:
        """Return the best end of a search from each start."""
        from scipy.optimize import least_squares

        best, least, ended = np.zeros(len(self.keys)), math.inf, False
        low = np.array(
            [
                0.0 if name in (DELAY, "inv_T_roll") or "frequency" in name else -np.inf
                for _, name in self.keys
            ]
        )
        for start in zip(*starts, strict=True):
            p = np.array([start[n][name] for n, name in self.keys])
            p = np.maximum(p, np.where(np.isfinite(low), low + 1e-6, p))
            scale = np.maximum(np.abs(p), 1e-2)
            solution = least_squares(
                self.residuals, p, bounds=(low, np.inf), x_scale=scale, max_nfev=300
            )
            if solution.cost < least:
                best, least, ended = solution.x, float(solution.cost), solution.status > 0
        return best, ended

    def told(self, p: np.ndarray, converged: bool) -> TransferFit:
        """The result with deviations by the errors of the responses and their correlation."""
        slopes = self.slopes(p)
        normal = slopes.T @ slopes
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12) / np.outer(
            scale, scale
        )
        covariance = self.noise()
        gains = inverse @ slopes.T
        parameters = gains @ covariance @ gains.T
        spread = np.sqrt(np.maximum(np.diag(parameters), 0.0))
        conditional = conditional_std(parameters)
        values = self.values(p)
        functions = []
        for n, (target, form) in enumerate(zip(self.targets, self.forms, strict=True)):
            own = {
                name: self.keys.index((0 if name in self.shared else n, name))
                for name in form.parameters
                if name not in self.fixed
            }
            model = form.response(values[n], target.omega)
            top, bottom = form.polynomials(values[n])
            functions.append(
                FittedResponse(
                    target.name,
                    form,
                    values[n],
                    {name: float(spread[at]) for name, at in own.items()},
                    {name: float(conditional[at]) for name, at in own.items()},
                    mismatch_cost(target.response, model, target.coherence),
                    top,
                    bottom,
                    parameters[np.ix_(list(own.values()), list(own.values()))],
                )
            )
        cost = float(np.mean([each.cost for each in functions]))
        return TransferFit(tuple(functions), cost, self.shared, converged)

    def slopes(self, p: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals by central differences."""
        columns = []
        for k, value in enumerate(p):
            step = 1e-5 * max(abs(value), 1e-2)
            more, less = p.copy(), p.copy()
            more[k] += step
            less[k] -= step
            columns.append((self.residuals(more) - self.residuals(less)) / (2.0 * step))
        return np.array(columns).T

    def noise(self) -> np.ndarray:
        """Covariance of the weighted errors: of each response's neighbours by their windows."""
        return weighted_noise(self.targets)


def conditional_std(covariance: np.ndarray) -> np.ndarray:
    """Return the standard deviations ``(q,)`` of parameters, each with all others known.

    1/sqrt((C^-1)_ii) of the covariance C ``(q, q)``: Tischler's insensitivity 1/sqrt(H_ii), with
    the inverse covariance in the place of the Hessian. It is at most sqrt(C_ii).

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
    # Where C is singular the pseudo-inverse may lie below one on its diagonal.
    return np.asarray(std / np.sqrt(np.maximum(np.diag(inverse), 1.0)))


def weighted_errors(targets: Sequence[ResponseTarget], ratios: Sequence[np.ndarray]) -> np.ndarray:
    """Errors in dB and degrees whose squares sum to the sum of the costs, of logarithms ``ratios``
    of model over response; of each target the gains first."""
    out = []
    for target, ratio in zip(targets, ratios, strict=True):
        root = np.sqrt(coherence_weight(target.coherence) * _COST_FREQUENCIES / target.omega.size)
        out += [_DECIBELS_PER_NEPER * root * ratio.real]
        out += [math.sqrt(PHASE_WEIGHT) * _DEGREES_PER_RADIAN * root * ratio.imag]
    result = np.concatenate(out)
    return np.where(np.isfinite(result), np.clip(result, -1e6, 1e6), 1e6)


def weighted_noise(targets: Sequence[ResponseTarget]) -> np.ndarray:
    """Covariance of ``weighted_errors``: of each response's neighbours by their windows."""
    sizes = [target.omega.size for target in targets]
    out = np.zeros((2 * sum(sizes), 2 * sum(sizes)))
    at = 0
    for target, size in zip(targets, sizes, strict=True):
        weight = np.sqrt(coherence_weight(target.coherence) * _COST_FREQUENCIES / size)
        relative = target.std / np.abs(target.response)
        alike = shared_correlation(target.omega, target.length)
        for factor in (_DECIBELS_PER_NEPER, math.sqrt(PHASE_WEIGHT) * _DEGREES_PER_RADIAN):
            rows = slice(at, at + size)
            out[rows, rows] = alike * np.outer(*(2 * [factor * weight * relative]))
            at += size
    return out


def shared_correlation(omega: np.ndarray, length: float | np.ndarray) -> np.ndarray:
    """Correlation ``(F, F)`` of the errors at frequencies ``omega``, rad/s, under windows of
    ``length``, s, one or ``(F,)``: short windows, which high frequencies have, join more of them.
    """
    frequency_difference = np.subtract.outer(omega, omega) / (2.0 * math.pi)
    return neighbour_correlation(frequency_difference * 0.5 * np.add.outer(length, length))


def neighbour_correlation(bins: np.ndarray) -> np.ndarray:
    """Correlation of the errors of a response at frequencies ``bins`` = difference times length
    apart, under Hann windows: the squared transform of the squared window."""
    x = np.asarray(bins, dtype=float)
    # hann^2 = 3/8 - cos/2 + cos(2.)/8, and each cosine shifts a sinc by one bin.
    transform = 0.375 * np.sinc(x) + 0.25 * (np.sinc(x - 1.0) + np.sinc(x + 1.0))
    transform += 0.0625 * (np.sinc(x - 2.0) + np.sinc(x + 2.0))
    return np.asarray((transform / 0.375) ** 2)


def _start(
    target: ResponseTarget, form: Form, fixed: Mapping[str, float]
) -> list[dict[str, float]]:
    """Parameters by linear least squares (Sanathanan and Koerner, IEEE Trans. Automatic Control
    8(1), 1963), for several delays."""
    tried = (*_DELAYS, *(share * _group_delay(target) for share in _SHARES))
    delays = (fixed[DELAY],) * len(tried) if DELAY in fixed else tried
    out = []
    for delay in delays:
        s = 1j * target.omega
        data = target.response * np.exp(s * delay)
        scale = float(np.exp(np.mean(np.log(target.omega))))
        z = s / scale
        n, m = form.orders
        bottom = np.ones(s.size, dtype=complex)
        weight = np.sqrt(coherence_weight(target.coherence)) / np.abs(data)
        solution = np.zeros(n + m + 1)
        for _ in range(_START_ITERATIONS):
            rows = [z**k for k in range(n + 1)] + [-data * z**k for k in range(m)]
            matrix = (np.array(rows) * weight / np.abs(bottom)).T
            goal = data * z**m * weight / np.abs(bottom)
            real = np.concatenate([matrix.real, matrix.imag])
            solution = np.linalg.lstsq(real, np.concatenate([goal.real, goal.imag]), rcond=None)[0]
            bottom = z**m + np.array([z**k for k in range(m)]).T @ solution[n + 1 :]
        top = [solution[k] * scale ** (m - k) for k in range(n, -1, -1)]
        down = [1.0, *(solution[n + 1 + k] * scale ** (m - k) for k in range(m - 1, -1, -1))]
        out.append(form.values_of(np.array(top), np.array(down), delay) | dict(fixed))
    return out


def _group_delay(target: ResponseTarget) -> float:
    """Return the mean slope of the phase over the upper half of the band, s, not negative."""
    upper = target.omega >= 0.5 * target.omega[-1]
    if np.count_nonzero(upper) < 2:
        return 0.0
    slope = np.polyfit(target.omega[upper], np.unwrap(np.angle(target.response[upper])), 1)[0]
    return max(float(-slope), 0.0)


@dataclass(frozen=True, eq=False)
class Envelopes:
    """Envelopes of maximum unnoticeable added dynamics, ``(F,)`` each: dB and degrees."""

    low_gain: np.ndarray
    high_gain: np.ndarray
    low_phase: np.ndarray
    high_phase: np.ndarray


PILOTED = (0.1, 10.0)  # rad/s, in which the envelopes are judged
# Of s, highest power first, by Hodgkinson and Wood (McDonnell Douglas), as in MIL-STD-1797A. Prints
# that multiply the phases by short delays have a wider envelope, by up to 4 deg at 10 rad/s.
_GAINS = (([0.0955, 9.92, 2.15], [1.0, 11.60, 4.95]), ([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]))
_PHASES = (
    ([475.32, 184100.0, 29460.0], [1.0, 11.66, 0.0389]),
    ([68.89, 1100.12, -275.22], [1.0, 39.94, 9.99]),
)


def unnoticeable(omega: np.ndarray) -> Envelopes:
    """Envelopes within which pilots do not notice dynamics that are added to an aircraft.

    Wood and Hodgkinson, "Definition of Acceptable Levels of Mismatch for Equivalent Systems of
    Augmented CTOL Aircraft", MDC A6792, McDonnell Douglas 1980; MIL-STD-1797A. ``omega`` : rad/s.
    """
    s = 1j * np.asarray(omega)

    def curve(top: list[float], bottom: list[float]) -> np.ndarray:
        return np.asarray(np.polyval(top, s) / np.polyval(bottom, s))

    gains = [20.0 * np.log10(np.abs(curve(*each))) for each in _GAINS]
    phases = [np.degrees(np.angle(curve(*each))) for each in _PHASES]
    return Envelopes(gains[0], gains[1], phases[0], phases[1])
