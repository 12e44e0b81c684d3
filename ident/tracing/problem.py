"""Problem of one search, which is immutable, and the search context of its records.

The context has spans, sizes of inputs and peaks of the residual spectrum; effects take their
starting values from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.statistics.noise_levels import spectral_peaks, update_period
from ident.tracing.diagnosis import TraceSettings
from ident.tracing.fitted_model import FitData, FittedModel, fit_set, start_from
from ident.whole_record.layout import FitSettings
from sim.declaration.effect import AIRSPEEDS, NoiseEffect
from sim.declaration.model import Model
from sim.declaration.proposal import SearchContext, Traceable
from sim.record import Record

# ---- The problem

MOST_ITERATIONS = 300  # of a converged fit; fits with correlated parameters take up to 200
# A fit has converged if a step gains less log likelihood: it moves less than 0.0015 sigmas.
SETTLED_LOG_LIKELIHOOD = 1e-6
# the same with unknown noise levels, which converge slowly: less than 0.2 sigmas
SETTLED_WITH_NOISE_LEVELS = 0.02


def no_progress(text: str, share: float) -> None:
    """Do nothing: the progress function if the caller gives none."""


@dataclass(frozen=True, eq=False)
class _StoredFit:
    """A fit that was made, with its arguments: equal requests reuse it."""

    start: FittedModel | None
    effects: tuple[Traceable, ...]
    added: Mapping[str, float]
    rough: bool
    fitted: FittedModel | None


@dataclass(frozen=True, eq=False)
class TraceProblem:
    """Records, masks, the declared model, and the effects that may be added.

    ``masks`` ``(m, N)`` a record, True where a sample counts. ``candidates`` : effects and
    catch-all terms. ``predicted`` : records that will be predicted; only the ranges they fly
    through are used. ``least_noise`` : by output, smallest measurement noise. ``kinematic`` :
    effects with kinematic evidence, for each the names that this evidence cannot distinguish, the
    likeliest first. ``progress`` is called with the current task and its share of the work.
    """

    records: Sequence[Record]
    masks: Sequence[np.ndarray]
    model: Model
    candidates: Sequence[Traceable]
    outputs: Sequence[str]
    settings: TraceSettings
    predicted: Sequence[Record] = ()
    progress: Callable[[str, float], None] = no_progress
    least_noise: Mapping[str, float] = field(default_factory=dict)
    kinematic: tuple[tuple[str, ...], ...] = ()
    _stored_fits: list[_StoredFit] = field(default_factory=list, init=False, repr=False)

    @property
    def guards(self) -> frozenset[str]:
        """Names of the catch-all terms, which compete and are never claimed."""
        return frozenset(candidate.name for candidate in self.candidates if candidate.traits.guard)

    @property
    def background(self) -> frozenset[str]:
        """Names of the nuisance dynamics, which any record may have."""
        return frozenset(each.name for each in self.candidates if each.traits.background)

    @property
    def named_by_kinematics(self) -> frozenset[str]:
        """All names with kinematic evidence."""
        return frozenset(name for group in self.kinematic for name in group)

    @property
    def data(self) -> FitData:
        """Data of the fits."""
        return FitData(self.records, self.masks, self.model, self.outputs, self.least_noise)

    @property
    def roughly(self) -> FitSettings:
        """Settings of a fit for comparison: the double step changes no output by a hundredth of its
        noise.
        """
        return FitSettings(
            max_step=2.0 * self.settings.max_step,
            iterations=14,
            tolerance=0.03,
            enough=0.2,
            quick=True,
        )

    def fit(
        self,
        effects: Sequence[Traceable],
        start: FittedModel | None,
        added: Mapping[str, float] | None = None,
        *,
        rough: bool = False,
    ) -> FittedModel | None:
        """Return the fit of a set, started from the values of another; None if no cost is finite.

        ``added`` : starting values of further parameters. ``rough`` : coarse, as during the search;
        else to convergence. Fits are stored, and an equal request returns the stored one.
        """
        request = (start, tuple(effects), dict(added or {}), rough)
        for one in reversed(self._stored_fits):
            same = one.start is start or (start is None and not effects)
            if same and (one.effects, one.added, one.rough) == request[1:]:
                return one.fitted
        random = any(isinstance(effect, NoiseEffect) for effect in effects)
        enough = SETTLED_WITH_NOISE_LEVELS if random else SETTLED_LOG_LIKELIHOOD
        settings = FitSettings(self.settings.max_step, iterations=MOST_ITERATIONS, enough=enough)
        fitted = self._fit(effects, self.roughly if rough else settings, start, added)
        self._stored_fits.append(_StoredFit(*request, fitted))
        return fitted

    def _fit(
        self,
        effects: Sequence[Traceable],
        settings: FitSettings,
        start: FittedModel | None,
        added: Mapping[str, float] | None,
    ) -> FittedModel | None:
        return fit_set(self.data, effects, settings, start_from(start, added))

    def with_kinematics(self, groups: Sequence[tuple[str, ...]]) -> TraceProblem:
        """Return the problem with other kinematic evidence; it keeps the stored fits."""
        other = replace(self, kinematic=tuple(groups))
        other._stored_fits.extend(self._stored_fits)
        return other

    def with_masks(self, masks: Sequence[np.ndarray]) -> TraceProblem:
        """Return the problem with other masks, without stored fits."""
        return replace(self, masks=tuple(masks))


# ---- Numbers of the records that a search starts from


def search_context(fitted: FittedModel, predicted: Sequence[Record] = ()) -> SearchContext:
    """Return the common search context of a fitted model's records: the longest span, the largest
    inputs, the ranges of the fitted outputs.

    ``predicted`` : further records that the model must predict; their outputs widen the ranges. The
    outermost hundredth of their samples is left out, as it may hold spikes.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    problems, lines = layout.problems, fit.linearisations
    records = [problem.record for problem in problems]
    longest = max(records, key=lambda record: record.time[-1] - record.time[0])
    peak: dict[str, float] = {}
    rate: dict[str, float] = {}
    states: dict[str, float] = {}
    flown: dict[str, tuple[float, float]] = {}
    for record in records:
        for channel in record.inputs:
            peak[channel.name] = max(
                peak.get(channel.name, 0.0), float(np.max(np.abs(channel.values)))
            )
            steps = np.abs(np.diff(channel.values)) / np.diff(record.time)
            rate[channel.name] = max(rate.get(channel.name, 0.0), float(steps.max()))
            low, high = flown.get(channel.name, (np.inf, -np.inf))
            flown[channel.name] = (
                min(low, float(channel.values.min())),
                max(high, float(channel.values.max())),
            )
    for names, rows in (
        (layout.system.state_names, [line.states for line in lines]),
        (layout.system.output_names, [line.y for line in lines]),
    ):
        for i, name in enumerate(names):
            low, high = min(float(r[i].min()) for r in rows), max(float(r[i].max()) for r in rows)
            flown.setdefault(name, (low, high))
            states.setdefault(name, max(abs(low), abs(high)))
    for record in predicted:
        for channel in record.channels:
            values = channel.values[channel.valid]
            edges = (0.0, 1.0) if channel.name in record.input_names else (0.005, 0.995)
            low, high = (float(v) for v in np.quantile(values, edges))
            if channel.name in flown:
                flown[channel.name] = (
                    min(low, flown[channel.name][0]),
                    max(high, flown[channel.name][1]),
                )
    return SearchContext(
        begin=float(longest.time[0]),
        end=float(longest.time[-1]),
        interval=float(np.median(np.diff(longest.time))),
        input_peak=peak,
        input_rate=rate,
        state_peak=states,
        flown=flown,
        residual_peaks=spectral_peaks(
            records,
            fit.residuals,
            [problem.valid for problem in problems],
            fit.variance,
        ),
        update_periods={
            name: update_period(
                [record.time for record in records],
                [line.y[i] for line in lines],
                [residuals[i] for residuals in fit.residuals],
            )
            for i, name in enumerate(layout.system.output_names)
        },
        airspeed=next(
            (
                fitted.model.parameters[name].value
                for name in AIRSPEEDS
                if name in fitted.model.parameters
            ),
            0.0,
        ),
        values=dict(
            zip(layout.system.parameters.names, layout.split(fit.theta, 0)[0].tolist(), strict=True)
        ),
    )
