"""Data of figures: axis labels and units, histories of filters, candidates of a diagnosis, spectra
of residuals, values and signals of studies.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.estimate import FilterHistory
from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.report.quantities import NO_UNIT, shown_in
from sim.declaration.proposal import GUARD

# ---- Axis labels: textbook symbols for names, degrees for radians


@dataclass(frozen=True)
class DisplayUnit:
    """A display unit: ``text`` for the axis label, and ``factor`` from the SI unit."""

    text: str
    factor: float = 1.0


POUNDS_PER_SQUARE_FOOT = DisplayUnit("lb/ft²", 0.3048**2 / 0.45359237)
KILOMETRES = DisplayUnit("km", 1e-3)
METRES_PER_SECOND = DisplayUnit("m/s")

# Legend labels of samples; figures mark simulated records as such.
MEASURED_DATA, SIMULATED_DATA = "measured", "simulated record"

_EXPONENTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_POWERS = str.maketrans("234", "²³⁴")
_SIGNALS = {
    "alpha": r"$\alpha$",
    "q": "$q$",
    "nz": "$n_z$",
    "theta": r"$\theta$",
    "airspeed": "$V$",
    "nx": "$n_x$",
    "beta": r"$\beta$",
    "p": "$p$",
    "r": "$r$",
    "phi": r"$\phi$",
    "ny": "$n_y$",
    "psi": r"$\psi$",
    "height": "height $h$",
    "elevator": r"elevator $\delta_e$",
    "aileron": r"aileron $\delta_a$",
    "rudder": r"rudder $\delta_r$",
    # Inputs from a measured airspeed: its change, and the lift that this adds.
    "airspeed_change": "$V - V_0$",
    "lift": "added lift",
    "thrust": "thrust $T$",
    "stick": r"stick $\delta_p$",
}
_SYMBOLS = {
    "inv_tau": r"$1/\tau$",
    "delay": "$t_d$",
    "delta": r"$\delta$",
    "delta_0": r"$\delta_0$",
    "nz_0": "$n_{z0}$",
    "natural_frequency": r"$\omega_n$",
    "damping_ratio": r"$\zeta$",
}
# Nested subscripts are flattened: they would be too small in tick labels.
_ARGUMENTS = {
    "alpha": r"\alpha",
    "q": "q",
    "de": r"\delta e",
    "delta": r"\delta",
    "0": "0",
    "V": "V",
    "beta": r"\beta",
    "p": "p",
    "r": "r",
    "da": r"\delta a",
    "dr": r"\delta r",
}
# Names of signals in products, as in parameter names.
_FACTORS = {
    **{name: _ARGUMENTS[name] for name in ("alpha", "beta", "p", "q", "r")},
    "elevator": r"\delta e",
    "aileron": r"\delta a",
    "rudder": r"\delta r",
    "mach": "M",
}


def display_unit(unit: str, name: str = "") -> DisplayUnit:
    """Return the display unit of an SI unit, with typeset powers.

    ``name`` distinguishes a frequency from a rate. Unknown units are kept.
    """
    factor, shown = shown_in(unit, name)
    if shown in NO_UNIT:
        return DisplayUnit("–", factor)
    text = re.sub(r"(?<=[A-Za-z])[234]\b", lambda power: power[0].translate(_POWERS), shown)
    return DisplayUnit(escaped_dollars(text), factor)


def axis_label(name: str, unit: DisplayUnit) -> str:
    """Return symbol and unit, as ``"$q$ (deg/s)"``."""
    return f"{symbol(name)} ({unit.text})"


def symbol(name: str) -> str:
    """Return the textbook symbol of a signal or parameter in mathtext, or the name itself."""
    if name in _SIGNALS or name in _SYMBOLS:
        return _SIGNALS.get(name) or _SYMBOLS[name]
    if name.startswith("bias_"):
        return f"bias of {symbol(name.removeprefix('bias_'))}"
    if match := re.fullmatch(r"(?:(C)([LDmYlnXZ])|(L|M))_(\w+)", name):
        argument = _argument(match[4]) or _product(match[4])
        if argument is not None:
            return f"${match[3]}_{{{argument}}}$" if match[3] else f"$C_{{{match[2]}{argument}}}$"
    if match := re.fullmatch(r"Ceta(\d+)_(\w+)", name):
        argument = _argument(match[2])
        if argument is not None:
            return rf"$C^{{\eta {match[1]}}}_{{{argument}}}$"
    if argument := _argument(name):
        return f"${argument}$"
    return escaped_dollars(name)


def scaled_unit(unit: DisplayUnit, size: float) -> DisplayUnit:
    """Return the unit times a power of 1000, so that values of ``size`` have short tick labels."""
    if not (size > 0.0 and math.isfinite(size)) or 0.02 <= size < 2e4:
        return unit
    power = 3 * math.floor(math.log10(size) / 3.0)
    text = "10" + str(power).translate(_EXPONENTS)
    return DisplayUnit(
        text if unit.text == "–" else f"{text} {unit.text}", unit.factor * 10.0**-power
    )


def signed(value: float, form: str) -> str:
    """Return a number with its sign and a typographic minus, in a format such as ``".3g"``."""
    return format(value, f"+{form}").replace("-", "−")


def escaped_dollars(text: str) -> str:
    """Return a text with its dollar signs escaped."""
    return text.replace("$", r"\$")


def _argument(text: str) -> str | None:
    """Return the symbol of a derivative's argument; None if it is unknown."""
    if match := re.fullmatch(r"(eta|etadot)(\d+)", text):
        return rf"\eta {match[2]}" if match[1] == "eta" else rf"\dot{{\eta}} {match[2]}"
    return _ARGUMENTS.get(text)


def _product(text: str) -> str | None:
    """Return the symbol of a product such as ``alpha2_elevator``; None for unknown factors."""
    if not re.fullmatch(r"(?:_?(?:abs_[a-z]+?|[a-z]+?)[234]?(?=_|$))+", text):
        return None
    factors = []
    for name, power in re.findall(r"_?(abs_[a-z]+?|[a-z]+?)([234]?)(?=_|$)", text):
        factor = _FACTORS.get(name.removeprefix("abs_"))
        if factor is None:
            return None
        if name.startswith("abs_"):
            factor = f"|{factor}|"
        factors.append(f"{factor}^{power}" if power else factor)
    return r"\,".join(factors)


# ---- Histories of filters

_HUGE = 1e30  # limit of the values of a diverged filter


@dataclass(frozen=True, eq=False)
class StateHistory:
    """Time, mean and sigma of a filter state, ``(K,)`` each, up to a divergence of the filter."""

    time: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def course(history: FilterHistory, name: str, factor: float = 1.0) -> StateHistory:
    """Return the history of a state or parameter, times ``factor``, up to a divergence."""
    row, sound = history.names.index(name), sound_samples(history)
    mean = np.clip(factor * history.mean[row, :sound], -_HUGE, _HUGE)
    std = np.clip(factor * history.std[row, :sound], 0.0, _HUGE)
    return StateHistory(history.time[:sound], mean, std)


def sound_samples(history: FilterHistory) -> int:
    """Return the number of samples before a filter diverged.

    Afterwards the history repeats the last finite sample, without measurements and with identity
    transitions.
    """
    identity = np.eye(len(history.names))
    repeated = ~np.any(history.valid, axis=0) & np.all(history.transition == identity, axis=(1, 2))
    good = np.flatnonzero(~repeated)
    return int(good[-1]) + 1 if good.size else 0


def settled_limits(
    low: np.ndarray, middle: np.ndarray, high: np.ndarray, marks: Sequence[float]
) -> tuple[float, float]:
    """Return axis limits that show the second half of an estimate and the marks.

    The early, uncertain part may be cut off.

    Parameters
    ----------
    low, middle, high : estimate and limits of its band, ``(K,)``.
    marks : further values to show.
    """
    half = len(middle) // 2
    ends = np.array([low[-1], high[-1], middle[half:].min(), middle[half:].max(), *marks])
    bottom, top = float(ends.min()), float(ends.max())
    span = top - bottom or abs(top) or 1.0
    bottom = max(bottom - 1.2 * span, min(bottom, float(middle.min())))
    top = min(top + 1.2 * span, max(top, float(middle.max())))
    margin = 0.12 * (top - bottom or span)
    return bottom - margin, top + margin


# ---- Short reasons against candidates, for the figure of the evidence


@dataclass(frozen=True)
class NamedEffects:
    """Effects of a verdict.

    Attributes
    ----------
    claimed : names of the claimed effects.
    alternatives : claim -> its alternatives.
    hints : names of effects that are hints only.
    noise_left : whether the residual of the model with the claimed effects is noise.
    """

    claimed: tuple[str, ...] = ()
    alternatives: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    noise_left: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """Claimed effects, alternatives and hints."""
        alternatives = [name for names in self.alternatives.values() for name in names]
        return (*self.claimed, *alternatives, *self.hints)

    def complete(self, within: tuple[str, ...]) -> bool:
        """Return whether a model with these effects needs no further one."""
        return self.noise_left and set(self.claimed) <= set(within)


def is_alternative(candidate: Candidate, standing: NamedEffects) -> bool:
    """Return whether a candidate can replace one claim in a model that has all other claims."""
    return any(
        candidate.name in names and set(standing.claimed) - {claim} <= set(candidate.within)
        for claim, names in standing.alternatives.items()
    )


def reason(candidate: Candidate, standing: NamedEffects, of_round: Sequence[Candidate]) -> str:
    """Return the role of a candidate in the verdict, or the reason against it.

    ``of_round`` are the candidates of its round.
    """
    if candidate.name in standing.claimed:
        return "claimed"
    if is_alternative(candidate, standing):
        return "an alternative"
    if candidate.name in standing.hints:
        return "hint only"
    if standing.complete(candidate.within) or candidate.weight <= 0.0:
        return "not needed"
    if candidate.name.startswith(GUARD):
        return "no effect of the library"
    claimed = [other for other in of_round if other.name in standing.claimed]
    if claimed and candidate.weight > min(other.weight for other in claimed):
        return "its whole sets: lower odds"
    if not candidate.fitted:
        return "linearised: lower odds"
    if claimed:
        similar = any(other.name in candidate.collinear_with for other in claimed)
        return "like the claimed, lower odds" if similar else "lower odds"
    if candidate.weight < max(other.weight for other in of_round):
        return "lower odds"
    return "not spread evenly"


# ---- Data of the figures of a diagnosis


@dataclass(frozen=True, eq=False)
class Replicated:
    """Parameters of an effect, fitted to each record and to all records.

    Attributes
    ----------
    name : name of the effect.
    records : labels of the records.
    by_record : parameters from each record.
    together : parameters from all records together.
    """

    name: str
    records: tuple[str, ...]
    by_record: tuple[Mapping[str, Quantity], ...]
    together: Mapping[str, Quantity]


@dataclass(frozen=True, eq=False)
class Pictured:
    """Data of the figures of a diagnosis.

    Attributes
    ----------
    fitted, predictions : fitted and predicted records.
    candidates : candidates of all rounds.
    before, after : parameters of the declared model and of the model with effects.
    noise : sigma of the noise of each channel.
    standing : effects of the verdict.
    kind : whether the predicted records are held out or fitted.
    replicated : parameters of effects from each record.
    data : legend label of the samples.
    """

    fitted: tuple[FittedRecord, ...]
    predictions: tuple[Prediction, ...]
    candidates: tuple[Candidate, ...]
    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    noise: Mapping[str, float]
    standing: NamedEffects
    kind: str
    replicated: tuple[Replicated, ...] = ()
    data: str = MEASURED_DATA


# ---- Spectra and coherence of residuals

COHERENCE_SEGMENTS = 15  # segments of a record for a coherence; they overlap by half
EXCEEDED_SHARE = 0.05  # probability that the coherence of noise exceeds the drawn level
INPUT_REGULARIZATION = 1e-9  # share of the inputs' power, for inputs that depend on each other
SMALLEST_POWER = 1e-300  # keeps the matrix of inputs without power regular
FEWEST_SMOOTHED_SAMPLES = 100  # spectra of shorter series are not smoothed
SMOOTHED_FREQUENCIES = 5  # neighbouring frequencies in a mean


def input_coherence(
    residual: np.ndarray, inputs: np.ndarray, interval: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, Hz, and the multiple coherence of a residual with the inputs at each.

    The coherence is the share of the residual's power that follows the inputs linearly (Bendat and
    Piersol, *Random Data*, 4th edition, 2010, chapter 7).

    Parameters
    ----------
    residual : samples ``(N,)``.
    inputs : samples ``(q, N)``.
    interval : sampling interval, s.
    """
    length = 2 * residual.size // (COHERENCE_SEGMENTS + 1)
    starts = range(0, residual.size - length + 1, max(length // 2, 1))
    # SciPy's signal package is not used: it takes longer to load than this to compute.
    segments = np.array(
        [[row[start : start + length] for start in starts] for row in (*inputs, residual)]
    )
    segments = segments - segments.mean(axis=2, keepdims=True)
    transforms = np.fft.rfft(segments * np.hanning(length), axis=2)
    matrix = np.einsum("asf,bsf->fab", transforms.conj(), transforms) / len(starts)
    # Cross spectra of the inputs, of inputs and residual, and the spectrum of the residual.
    of_inputs, cross, power = matrix[:, :-1, :-1], matrix[:, :-1, -1], matrix[:, -1, -1].real
    unit = np.eye(len(inputs))
    trace = np.trace(of_inputs, axis1=1, axis2=2).real[:, None, None]
    of_inputs = of_inputs + INPUT_REGULARIZATION * trace * unit
    solved = np.linalg.solve(of_inputs + SMALLEST_POWER * unit, cross[..., None])[..., 0]
    share = np.sum(cross.conj() * solved, axis=1).real / np.where(power > 0.0, power, np.inf)
    hertz = np.fft.rfftfreq(length, interval)
    return hertz[1:], np.clip(share, 0.0, 1.0)[1:]


def coherence_level(inputs: int) -> float:
    """Return the multiple coherence that noise alone exceeds with ``EXCEEDED_SHARE``.

    ``inputs`` is the number of inputs. There are ``COHERENCE_SEGMENTS`` segments.
    """
    from scipy.special import betaincinv

    return float(betaincinv(inputs, COHERENCE_SEGMENTS - inputs, 1.0 - EXCEEDED_SHARE))


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, Hz, and the power of a series at each; that of white noise is its
    variance.

    Parameters
    ----------
    residual : samples ``(N,)``, zero where they are missing.
    interval : sampling interval, s.
    used : number of samples that are not missing.
    """
    count = len(residual)
    window = np.hanning(count)
    scale = float(np.sum(window**2)) * max(used, 1) / count
    power = np.abs(np.fft.rfft(residual * window)) ** 2 / scale
    hertz = np.fft.rfftfreq(count, interval)
    width = 1 if count < FEWEST_SMOOTHED_SAMPLES else SMOOTHED_FREQUENCIES
    smooth = np.convolve(power[1:], np.ones(width) / width, mode="valid")
    return hertz[1 + width // 2 : 1 + width // 2 + len(smooth)], smooth


# ---- Data of the figures that compare studies


@dataclass(frozen=True)
class StudyValue:
    """Estimate of one parameter in one study, all numbers in ``unit``.

    Attributes
    ----------
    estimate, std : estimate and its standard deviation; 0 if unknown.
    true : true value, or None.
    condensed : value with the elastic modes statically condensed, which a model without these modes
        should find, or None.
    published : published value and its standard deviation, 0 if unknown; or None.
    """

    estimate: float
    std: float
    unit: str
    true: float | None = None
    condensed: float | None = None
    published: tuple[float, float] | None = None

    @property
    def reference(self) -> float | None:
        """Reference value of the error: the condensed value if there is one, else the true one."""
        return self.true if self.condensed is None else self.condensed

    @property
    def percent(self) -> float | None:
        """Error in per cent of the reference; None without a reference or if it is zero."""
        return (
            None
            if not self.reference
            else 100.0 * (self.estimate - self.reference) / abs(self.reference)
        )

    @property
    def sigmas(self) -> float | None:
        """Error in standard deviations of the estimate; None without reference or deviation."""
        return (
            None
            if self.reference is None or not self.std > 0.0
            else (self.estimate - self.reference) / self.std
        )

    def in_unit(self, factor: float, unit: str) -> StudyValue:
        """Return all numbers times ``factor``, in another ``unit``."""
        true, condensed = (
            None if value is None else factor * value for value in (self.true, self.condensed)
        )
        published = (
            (factor * self.published[0], factor * self.published[1])
            if self.published is not None
            else None
        )
        return StudyValue(
            factor * self.estimate, factor * self.std, unit, true, condensed, published
        )

    @property
    def published_value(self) -> StudyValue | None:
        """Published value and its standard deviation in place of the estimate, or None."""
        return (
            None
            if self.published is None
            else replace(self, estimate=self.published[0], std=self.published[1], published=None)
        )


@dataclass(frozen=True, eq=False)
class StudyResponses:
    """Signals of one study by name, ``(N,)`` each, SI; NaN if missing.

    Attributes
    ----------
    time : shape ``(N,)``, s.
    inputs, measured : inputs and measured outputs.
    predicted : outputs predicted by the estimate.
    true : outputs without noise; empty if unknown.
    units : unit of each channel.
    simulated : whether the record is simulated.
    """

    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]
    true: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    simulated: bool = False
