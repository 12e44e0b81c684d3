"""Search for a maneuver: every kind, scaled to its limits, compared at equal time.

Expected frequency responses (coherence, random error) are averages over simulated flights with
sensor noise, each estimated as by ``flightid response``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.frequency_response import LEAST_COHERENCE, EvenSignals, Spectra, estimate_responses
from ident.frequency_response.estimate import (
    decimated,
    frequencies,
    lowest_frequency,
    window_lengths,
)
from ident.maneuver_design import (
    ODDS_COST,
    ActingEffect,
    Contest,
    PlannedManeuver,
    contest,
    fit_declared_model,
    linear_squares,
    parameter_cost,
    shared_sigmas,
    simulate_maneuver,
)
from ident.tracing.fitted_model import FittedModel
from scenarios.maneuver_design.limits import no_faster, offset_of
from scenarios.maneuver_design.setting import (
    JUST_FOUND,
    KINDS,
    OVER_A_BAND,
    PRINTED_AS,
    TYPICAL,
    DesignRequest,
    Setting,
    numbers_of,
    setting_of,
)
from sim.declaration.effect import NoiseEffect
from sim.declaration.model import Model
from sim.declaration.proposal import RangedCurve, Traceable
from sim.effects.library import find_effect
from sim.errors import DeclarationError, ModelError

MOST_ATTEMPTS = 16  # most amplitudes tried
PROPORTIONAL_ATTEMPTS = 4  # attempts with a correction in proportion
# exponent of the corrections after these: at a rate limit the peak hardly changes
LATER_CORRECTION_EXPONENT = 3.0
LIMIT_SHARE = 0.999  # margin to a limit, share, for errors of the simulation
TOO_WILD = 0.2  # factor on a maneuver whose simulation diverges


@dataclass(frozen=True, eq=False)
class LimitedManeuver:
    """A maneuver within its limits: ``deflections (inputs, N)`` from trim, the share ``scale`` of
    the amplitude, its simulation, and extremes by output.

    ``margins`` : by output, the share by which its excursion may grow until it reaches a limit;
    an output that does not move, or has no limit, has none.
    """

    deflections: np.ndarray
    scale: float
    planned: PlannedManeuver
    motion: FittedModel
    extremes: Mapping[str, tuple[float, float]]
    bound_by: str
    margins: Mapping[str, float] = field(default_factory=dict)

    @property
    def outputs(self) -> dict[str, np.ndarray]:
        """Simulated outputs by name, ``(N,)``; load factors of perturbation models from trim."""
        rows = self.motion.fit.linearisations[0].y
        return dict(zip(self.motion.system.output_names, rows, strict=True))


def within_limits(
    setting: Setting,
    shapes: np.ndarray,
    *,
    quick: bool = False,
    start: float = 1.0,
    bound_by: str = "",
) -> LimitedManeuver:
    """Return the maneuver of ``shapes (inputs, N)``, peaks of one, at the amplitude of the limits,
    or scaled down until the response stays inside.

    ``start`` : the scale to begin with, and ``bound_by`` what made it so. Raises DeclarationError
    if the limits leave nothing.
    """
    amplitude = np.array([*setting.limits.amplitude.values()])[:, None]
    rate = np.array([setting.limits.rate.get(name, np.inf) for name in setting.limits.amplitude])
    scale = min(1.0, start)
    for attempt in range(MOST_ATTEMPTS):
        deflections = no_faster(scale * amplitude * shapes, rate, setting.maneuver_limits.interval)
        planned = setting.planned(deflections, quick=quick)
        try:
            motion = simulate_maneuver(planned, slopes=False)
        except ModelError:
            scale *= TOO_WILD
            continue
        extremes = _extremes(setting, motion)
        shares = used_shares(setting, extremes)
        worst, name = max(((share, name) for name, share in shares.items()), default=(0.0, ""))
        if worst <= 1.0:
            margins = {name: 1.0 / share - 1.0 for name, share in shares.items() if share > 0.0}
            return LimitedManeuver(
                deflections, scale, planned, simulate_maneuver(planned), extremes, bound_by, margins
            )
        scale, bound_by = (
            scale
            * LIMIT_SHARE
            / worst ** (1.0 if attempt < PROPORTIONAL_ATTEMPTS else LATER_CORRECTION_EXPONENT),
            name,
        )
    raise DeclarationError(
        f"no maneuver stays within {bound_by or 'the limits'}",
        where="--limits",
        remedy="widen it, shorten the flight, or check the starting values",
    )


def _extremes(setting: Setting, motion: FittedModel) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest reading by output, load factors as totals."""
    rows = zip(motion.system.output_names, motion.fit.linearisations[0].y, strict=True)
    return {
        name: (
            offset_of(setting.model, name) + float(row.min()),
            offset_of(setting.model, name) + float(row.max()),
        )
        for name, row in rows
    }


def used_shares(setting: Setting, extremes: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the excursion from rest divided by its limit, of each output with a limit."""
    shares = {}
    for name, (low, high) in extremes.items():
        least, most = setting.limits.outputs.get(name, (-np.inf, np.inf))
        at = setting.still[name] + offset_of(setting.model, name)
        if not least < at < most:
            raise DeclarationError(
                f"{name} is {at:g} before any maneuver",
                where="--limits",
                remedy="let the limits hold the rest",
            )
        shares[name] = max((at - low) / (at - least), (high - at) / (most - at))
    return shares


NOISE_DRAWS = 8
USELESS_RANDOM_ERROR = 0.5  # random error above which a response is useless


@dataclass(frozen=True, eq=False)
class PredictedResponses:
    """Responses of m outputs to q inputs at F frequencies, expected of one flight.

    Attributes
    ----------
    frequency : Hz, ``(F,)``.
    inputs, outputs : names.
    coherence : ``(m, q, F)``, partial where there are several inputs, mean over draws.
    random_error : ``(m, q, F)``, of the magnitude, median over draws.
    usable : ``(m, q)``, share of the band, in its logarithm, with a coherence of 0.6 or more.
    """

    frequency: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    coherence: np.ndarray
    random_error: np.ndarray

    @property
    def usable(self) -> np.ndarray:
        """Share of the frequencies, evenly spaced in their logarithm, that would be usable."""
        return np.asarray(np.mean(self.coherence >= LEAST_COHERENCE, axis=2))

    @property
    def criterion(self) -> float:
        """Geometric mean of the random errors, each 50 % at most: the lower, the better."""
        return float(np.exp(np.mean(np.log(np.minimum(self.random_error, USELESS_RANDOM_ERROR)))))

    @property
    def content(self) -> dict[str, Any]:
        """The entry of ``design.json``."""
        return {
            "frequency_Hz": self.frequency.tolist(),
            "mean_random_error": self.criterion,
            "pairs": [
                {
                    "output": output,
                    "input": name,
                    "usable": float(self.usable[m, q]),
                    "coherence": self.coherence[m, q].tolist(),
                    "random_error": self.random_error[m, q].tolist(),
                }
                for m, output in enumerate(self.outputs)
                for q, name in enumerate(self.inputs)
            ],
        }


def predicted_responses(setting: Setting, flight: LimitedManeuver) -> PredictedResponses:
    """Return the frequency responses expected from a maneuver, over the setting's band."""
    assert setting.maneuver_limits.band is not None
    low, high = (omega / (2.0 * math.pi) for omega in setting.maneuver_limits.band)
    names = tuple(flight.motion.system.output_names)
    clean = np.array(flight.motion.fit.linearisations[0].y)
    duration = clean.shape[1] * setting.maneuver_limits.interval
    windows = window_lengths([duration], low)
    low = max(low, lowest_frequency(windows))
    at = frequencies(low, high)
    noise = np.array([setting.noise[name] for name in names])[:, None]
    rng = np.random.default_rng(1)
    coherence, errors = [], []
    for _ in range(NOISE_DRAWS):
        measured = clean + noise * rng.standard_normal(clean.shape)
        records, _ = decimated(
            [EvenSignals(setting.maneuver_limits.interval, flight.deflections, measured)], high
        )
        responses = estimate_responses(records, at, Spectra(windows))
        coherence.append(responses.partial_coherence)
        errors.append(responses.random_error)
    inputs = tuple(setting.trim_inputs)
    return PredictedResponses(
        at, inputs, names, np.mean(coherence, axis=0), np.median(errors, axis=0)
    )


# ---- Effects to be separated

MOST_EFFECTS = 3  # effects at once: a diagnosis names two alternatives at most
RANGE = ("low", "high")  # of a curve
MOST_HALVINGS = 24


def rivals_of(request: DesignRequest, model: Model) -> tuple[Traceable, ...]:
    """Return the effects named by ``--tell``.

    Raises
    ------
    DeclarationError : fewer than two, the same twice, one that cannot act on the model or has no
        simulation that could be compared.
    """
    names = list(request.tell)
    if not names:
        return ()
    if not 2 <= len(names) <= MOST_EFFECTS or len(set(names)) < len(names):
        raise DeclarationError(
            f"{len(names)} effects",
            where="--tell",
            remedy=f"name two different effects, {MOST_EFFECTS} at most: --tell A,B",
        )
    rivals = []
    for name in names:
        try:
            effect = find_effect(name, model.equations)
        except ModelError as error:
            raise DeclarationError(error.what, where="--tell", remedy=error.remedy) from None
        if (
            isinstance(effect, NoiseEffect)
            or not isinstance(effect, Traceable)
            or effect.traits.wrong_samples_of
        ):
            remedy = "no maneuver tells it: it is judged by innovations or sample by sample"
            raise DeclarationError(f"{name} is random", where="--tell", remedy=remedy)
        if any(present.name == effect.name for present in model.effects):
            raise DeclarationError(
                f"{name} belongs to the model already",
                where="--tell",
                remedy="name effects that it lacks",
            )
        rivals.append(effect)
    return tuple(rivals)


def sized(request: DesignRequest, effect: Traceable, reference: PlannedManeuver) -> ActingEffect:
    """Return the first effect as it acts: at the values of ``--size``, at typical ones, or where
    the reference maneuver just finds it.
    """
    typical = {item.name: item.value for item in effect.parameters}
    if request.size == TYPICAL:
        return ActingEffect(effect, typical)
    if request.size == JUST_FOUND:
        return barely_detectable(effect, reference)
    units = {item.name: item.unit for item in effect.parameters} | (
        {name: _unit(effect) for name in RANGE} if isinstance(effect, RangedCurve) else {}
    )
    given = numbers_of([request.size], units, "--size")
    over = {name: given.pop(name) for name in RANGE if name in given}
    form = replace(effect, **over) if over else effect  # type: ignore[type-var]
    return ActingEffect(form, {**typical, **given})


def barely_detectable(effect: Traceable, reference: PlannedManeuver) -> ActingEffect:
    """Return the effect scaled so that the tracing loop just accepts it in the reference maneuver.

    Raises DeclarationError if even twice the typical values are not detected.
    """
    typical = {item.name: item.value for item in effect.parameters}
    samples = len(reference.record) * len(reference.outputs)
    bar = ODDS_COST + parameter_cost(effect, np.array([samples]))

    def at(share: float) -> ActingEffect:
        values = {
            name: effect.absent[name] + share * (value - effect.absent[name])
            if name in effect.absent
            else value
            for name, value in typical.items()
        }
        return ActingEffect(effect, values)

    low, high = 0.0, 2.0
    if 2.0 * fit_declared_model(reference, at(high))[1].fit.cost < bar:
        raise DeclarationError(
            f"{effect.name} is not found at twice its usual size",
            where="--size found",
            remedy="give it a size",
        )
    for _ in range(MOST_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle)
            if 2.0 * fit_declared_model(reference, at(middle))[1].fit.cost > bar
            else (middle, high)
        )
        if high - low < 1e-3 * high:
            break
    return at(high)


def mimicking(reference: PlannedManeuver, true: ActingEffect, rival: Traceable) -> ActingEffect:
    """Return the rival at the values with which it looks most like the true effect; typical ones
    where it cannot.
    """
    result = contest(reference, true, rival)
    if result.gain - result.left < 0.5 * ODDS_COST:
        return ActingEffect(rival, {item.name: item.value for item in rival.parameters})
    return result.rival


def contests(planned: PlannedManeuver, acting: Sequence[ActingEffect]) -> tuple[Contest, ...]:
    """Return the first effect against each other one, and each of these against the first."""
    first, *others = acting
    out = []
    for other in others:
        out += [
            contest(planned, first, other.effect, hint=other.values),
            contest(planned, other, first.effect, hint=first.values),
        ]
    return tuple(out)


def _unit(effect: Traceable) -> str:
    """Return the unit of a curve's argument: an angle, or that of a stick."""
    return (
        "1" if getattr(effect, "unit", "rad") == "1" and getattr(effect, "control", "") else "rad"
    )


# ---- The search

PULSE_WIDTHS = (0.25, 0.5, 1.0, 2.0)  # share of the pulse length suggested by the roots
REFERENCE = "3-2-1-1"


@dataclass(frozen=True, eq=False)
class DesignedManeuver:
    """One kind at its best ``pulse_width``, s: the step of a 3-2-1-1 or doublet, and half a period
    of the highest frequency of a sweep or multisine.

    ``sigmas``: expected standard deviations of the free parameters. ``criterion``: geometric mean
    of sigma over value, of determined parameters. ``contests``: comparisons of effects to be
    separated. ``chance``: least probability of identifying the acting effect. ``responses``:
    expected frequency responses over the requested band.
    """

    kind: str
    pulse_width: float
    flight: LimitedManeuver
    sigmas: Mapping[str, float]
    criterion: float
    contests: tuple[Contest, ...] = ()
    responses: PredictedResponses | None = None

    @property
    def pace_text(self) -> str:
        """The pulse width as the step of step maneuvers, as the highest frequency of others."""
        if PRINTED_AS[self.kind] == "step":
            return f"step {self.pulse_width:.3g} s"
        return f"up to {0.5 / self.pulse_width:.3g} Hz"

    @property
    def chance(self) -> float:
        """The least over the effects of the probability that each is found, and preferred to all
        others by enough.
        """
        missed: dict[str, float] = {}
        for each in self.contests:
            missed[each.true.effect.name] = (
                missed.get(each.true.effect.name, 0.0) + 1.0 - each.chance
            )
        return max(0.0, 1.0 - max(missed.values(), default=1.0))

    @property
    def log_likelihood(self) -> float:
        """The least expected difference of the log likelihoods."""
        return min((each.decision.log_likelihood for each in self.contests), default=0.0)


@dataclass(frozen=True, eq=False)
class DesignResult:
    """Maneuvers, the best first, with the request; ``acting``: effects with their values."""

    request: DesignRequest
    setting: Setting
    maneuvers: tuple[DesignedManeuver, ...]
    acting: tuple[ActingEffect, ...] = ()

    @property
    def best(self) -> DesignedManeuver:
        return self.maneuvers[0]


def design(
    asked: DesignRequest, progress: Callable[[str, float], None] = lambda stage, share: None
) -> DesignResult:
    """Design a maneuver of each kind and rank them: by the chance to decide, else by the expected
    standard deviations.

    Raises
    ------
    DeclarationError : anything wrong in what is asked, in one line; limits that no maneuver keeps.
    """
    setting = setting_of(asked)
    effects = rivals_of(asked, setting.model)
    acting = _acting(asked, effects, _reference(setting)) if effects else ()
    designed = []
    able = [kind for kind in KINDS if kind in asked.flown.kinds]
    kinds = [kind for kind in able if asked.band is None or kind in OVER_A_BAND]
    for number, kind in enumerate(kinds):
        progress(kind, number / len(kinds))
        best = (
            _best_pulse_width(setting, kind, acting)
            if asked.band is None
            else _over_the_band(setting, kind)
        )
        if best is not None:
            designed.append(_weighed(setting, kind, *best, acting))
    if not designed:
        raise DeclarationError(
            "no kind of maneuver has room", where="--duration", remedy="give a longer one"
        )
    return DesignResult(asked, setting, tuple(sorted(designed, key=_rank)), acting)


def _over_the_band(setting: Setting, kind: str) -> tuple[float, np.ndarray, LimitedManeuver] | None:
    """Return pulse width, shapes and flight of one kind over the band; None if too long."""
    assert setting.maneuver_limits.band is not None
    pulse_width = np.pi / setting.maneuver_limits.band[1]
    shapes = KINDS[kind](setting.maneuver_limits, pulse_width)
    if shapes is None:
        return None
    return pulse_width, shapes, within_limits(setting, shapes, quick=True)


def _rank(maneuver: DesignedManeuver) -> tuple[float, float, float]:
    if maneuver.responses is not None:
        return (maneuver.responses.criterion, 0.0, maneuver.criterion)
    return (-round(maneuver.chance, 3), -min(maneuver.log_likelihood, 1e6), maneuver.criterion)


def _reference(setting: Setting) -> LimitedManeuver:
    """Return a 3-2-1-1 with a pulse width by the eigenvalues; it defines equal sizes of effects."""
    for share in (1.0, 0.63, 0.4, 0.25):
        shapes = KINDS[REFERENCE](setting.maneuver_limits, _sampled(setting, share))
        if shapes is not None:
            return within_limits(setting, shapes)
    raise DeclarationError(
        "there is no room for a 3-2-1-1", where="--duration", remedy="give a longer one"
    )


def _acting(
    request: DesignRequest, effects: Sequence[Traceable], reference: LimitedManeuver
) -> tuple[ActingEffect, ...]:
    try:
        first = sized(request, effects[0], reference.planned)
        return (first, *(mimicking(reference.planned, first, other) for other in effects[1:]))
    except ModelError as error:
        raise DeclarationError(
            f"{effects[0].name} of this size: {error.what}",
            where="--size",
            remedy="give a smaller one",
        ) from None


def _sampled(setting: Setting, share: float) -> float:
    """Return a pulse width that is a whole number of samples and not too short to fly, s."""
    interval = setting.maneuver_limits.interval
    least = math.ceil(setting.flyer.shortest_step / interval - 1e-9)
    return max(1, least, round(share * setting.maneuver_limits.pulse / interval)) * interval


def _best_pulse_width(
    setting: Setting, kind: str, acting: Sequence[ActingEffect]
) -> tuple[float, np.ndarray, LimitedManeuver] | None:
    """Return pulse width, shapes and flight with the best criterion; None if too long."""
    best, least = None, np.inf
    for pulse_width in dict.fromkeys(_sampled(setting, share) for share in PULSE_WIDTHS):
        shapes = KINDS[kind](setting.maneuver_limits, pulse_width)
        if shapes is None:
            continue
        try:
            flight = within_limits(setting, shapes, quick=True)
            cost = (
                -min(linear_squares(flight.planned, acting[0], other) for other in acting[1:])
                if acting
                else _criterion(flight)
            )
        except ModelError:
            continue
        if cost < least:
            best, least = (pulse_width, shapes, flight), cost
    return best


def _weighed(
    setting: Setting,
    kind: str,
    pulse_width: float,
    shapes: np.ndarray,
    quick: LimitedManeuver,
    acting: Sequence[ActingEffect],
) -> DesignedManeuver:
    flight = within_limits(setting, shapes, start=quick.scale, bound_by=quick.bound_by)
    sigmas = shared_sigmas(flight.motion.fit)
    responses = (
        predicted_responses(setting, flight) if setting.maneuver_limits.band is not None else None
    )
    contest_results = contests(flight.planned, acting) if acting else ()
    return DesignedManeuver(
        kind, pulse_width, flight, sigmas, _criterion(flight), contest_results, responses
    )


def _criterion(flight: LimitedManeuver) -> float:
    """Return the geometric mean of sigma over value, of parameters with a sigma below their value:
    lower is better.
    """
    sigmas = shared_sigmas(flight.motion.fit)
    parameters = flight.motion.model.parameters
    shares = [
        min(std / abs(parameters[name].value), 1.0)
        for name, std in sigmas.items()
        if parameters[name].value != 0.0
    ]
    return float(np.exp(np.mean(np.log(shares)))) if shares else 1.0
