"""Terms of a coefficient chosen by stepwise regression or by orthogonal functions.

Both methods work on sums of products over each maneuver. The number of samples then hardly matters,
and a maneuver is left out by subtraction.

Stepwise regression adds the term with the largest partial F ratio as long as this exceeds a
threshold, and removes terms whose ratio falls below it [1]_. Where no further term enters, a term
may be exchanged for one that explains clearly more in its place [3]_.

Orthogonal functions are made from the offered terms: each one is orthogonal to those before it.
They enter in the order of the sum of squares that they explain. Their number minimises the
predicted squared error [2]_

    PSE = SSE / N + s2_max n / N,   s2_max = sum (z - mean z)^2 / N

References
----------
.. [1] N. R. Draper and H. Smith, Applied Regression Analysis, 3rd ed., Wiley 1998, chapter 15.
.. [2] E. A. Morelli, Global nonlinear aerodynamic modeling using multivariate orthogonal functions,
   Journal of Aircraft 32(2), 1995.
.. [3] A. J. Miller, Subset Selection in Regression, 2nd ed., Chapman and Hall 2002, chapter 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.structure.averaging import Alternative, averaged_covariance
from ident.structure.coefficients import Histories
from ident.structure.products import (
    LARGE_RESIDUAL_RATIO,
    Products,
    TermColumns,
    cross_validated_r2,
    gains_of,
    losses_of,
    partial_f_ratio,
    values_of,
)
from sim.aerodynamics import Term, is_linear, parents

F_IN = 20.0  # partial F ratio of a term that enters (Klein and Morelli, section 5.4)
LEAST_VARIANCE_SHARE = 2e-4  # smallest share of the variance that a term has to explain
LARGEST_SIMPLER_F_RATIO = (
    4.0  # a simpler term may explain less by this partial F ratio (two sigmas)
)
# a weak linear term is a confounder where it changes the value of another one by more sigmas than
# NOTABLE_CHANGE, if its own F ratio exceeds CLEAR_F_RATIO, or than LARGE_CHANGE otherwise
NOTABLE_CHANGE, LARGE_CHANGE = 1.0, 2.0
CLEAR_F_RATIO = 5.0
# two terms cannot be distinguished where the variance inflation factor is larger
LARGEST_VARIANCE_INFLATION = 10.0
# Gains with a smaller relative difference count as equal: the term that was offered first enters.
EQUAL_GAIN_TOLERANCE = 1e-6
# most terms that are reported as lacking, and the smallest share of the residual that one explains
_MOST_LACKING, _LEAST_LACKING_SHARE = 3, 0.03
_STEPS_PAST_MINIMUM = 3  # steps of orthogonal functions after the least predicted squared error
STEPWISE, ORTHOGONAL = "stepwise", "orthogonal"


@dataclass(frozen=True)
class SelectionStep:
    """One step of a selection.

    Attributes
    ----------
    term : the term that was added or removed.
    added : whether it was added.
    F : its partial F ratio.
    r2 : coefficient of determination of the model after the step.
    pse : predicted squared error of this model.
    held_out : R2 of each maneuver as the others predict it; NaN with one maneuver.
    """

    term: Term
    added: bool
    F: float
    r2: float
    pse: float
    held_out: float


@dataclass(frozen=True, eq=False)
class Selection:
    """The terms chosen for a coefficient.

    Attributes
    ----------
    axis : name of the coefficient.
    method : ``stepwise`` or ``orthogonal``.
    steps : steps of the selection, in order.
    terms : the n chosen terms.
    values, sigma : ``(n,)`` their values and standard deviations.
    covariance : ``(n, n)`` of the values.
    ratios : ``(n,)`` partial F ratio of each term with all others in the model.
    r2, held_out : of the chosen model, as in `SelectionStep`.
    rms : of the residual.
    noise : rms of the part of the residual that is noise of the sensors.
    lacking : terms that were not offered and would explain the residual, each with its F ratio and
        the share of the residual.
    confounders : weak terms that were chosen because the values of others depend on them.
    alternative : another model that makes standard deviations clearly larger: the term that it
        adds, the term that it lacks, and its probability.
    """

    axis: str
    method: str
    steps: tuple[SelectionStep, ...]
    terms: tuple[Term, ...]
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    ratios: np.ndarray
    r2: float
    held_out: float
    rms: float
    noise: float
    lacking: tuple[tuple[Term, float, float], ...] = ()
    confounders: tuple[Term, ...] = ()
    alternative: tuple[Term | None, Term | None, float] | None = None

    @property
    def table(self) -> dict[Term, float]:
        """Values by term."""
        return dict(zip(self.terms, self.values.tolist(), strict=True))

    @property
    def ratio(self) -> float:
        """Rms of the residual over that of the noise."""
        return self.rms / self.noise if self.noise > 0.0 else math.inf


def stepwise(
    products: Products, *, first: Sequence[int] = (), hierarchical: bool = False
) -> tuple[list[int], list[SelectionStep]]:
    """Return the columns chosen by stepwise regression, and the steps.

    Parameters
    ----------
    products : sums of products; the constant term is in the model from the start.
    first : columns that enter before the others with any F ratio, since two terms that mask each
        other explain little alone. They are removed as other terms are.
    hierarchical : a product enters only after its linear terms, where these are offered.

    A term enters if its partial F ratio is at least ``F_IN`` and it explains
    ``LEAST_VARIANCE_SHARE`` of the variance. While the residual is larger than
    ``LARGE_RESIDUAL_RATIO`` times the noise, ``LEAST_RESIDUAL_SHARE`` of the residual is enough.
    """
    above = _parent_columns(products.terms, hierarchical)
    chosen, steps = _first_columns(products, first)
    seen: set[frozenset[int]] = set()
    chosen = _without_unsupported(products, chosen, steps, above)
    while frozenset(chosen) not in seen:
        seen.add(frozenset(chosen))
        gains, sse = gains_of(products, chosen)
        gains = np.where([required.issubset(chosen) for required in above], gains, 0.0)
        best = _first_best_column(gains) if len(gains) else -1
        F = partial_f_ratio(products, gains[best], sse - gains[best], len(chosen) + 1)
        if best < 0 or F_IN > F or gains[best] < products.least_gain(LEAST_VARIANCE_SHARE, sse):
            chosen, exchanged = _with_exchange(products, chosen, above)
            steps += exchanged
            continue
        chosen = [*chosen, best]
        steps.append(_selection_step(products, chosen, best, True, F))
        chosen = _without_unsupported(products, chosen, steps, above)
    return chosen, steps


def _first_columns(
    products: Products, first: Sequence[int]
) -> tuple[list[int], list[SelectionStep]]:
    """Return the constant and the columns ``first``, in the order of their gains, and the steps.
    Columns whose independent part is mostly noise are left out.
    """
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    steps: list[SelectionStep] = []
    while True:
        gains, sse = gains_of(products, chosen)
        gains = np.where(np.isin(np.arange(len(gains)), first), gains, 0.0)
        best = _first_best_column(gains) if len(gains) else -1
        if best < 0 or not gains[best] > 0.0:
            return chosen, steps
        F = partial_f_ratio(products, gains[best], sse - gains[best], len(chosen) + 1)
        chosen = [*chosen, best]
        steps.append(_selection_step(products, chosen, best, True, F))


def _without_unsupported(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    above: Sequence[frozenset[int]],
) -> list[int]:
    """Return the chosen columns without those that explain too little. Their removals are appended
    to ``steps``. ``above`` has for each column the columns of its parents.
    """
    while len(chosen) > 2:
        losses, sse = losses_of(products, chosen)
        needed = _required_columns(products.terms, chosen, above)
        losses = [math.inf if i in needed else loss for i, loss in zip(chosen, losses, strict=True)]
        worst = int(np.argmin(losses))
        F = partial_f_ratio(products, losses[worst], sse, len(chosen))
        if F_IN <= F and losses[worst] >= 0.5 * products.least_gain(LEAST_VARIANCE_SHARE, sse):
            break
        removed = chosen[worst]
        chosen = [i for i in chosen if i != removed]
        steps.append(_selection_step(products, chosen, removed, False, F))
    return chosen


def _with_exchange(
    products: Products, chosen: list[int], above: Sequence[frozenset[int]]
) -> tuple[list[int], list[SelectionStep]]:
    """Return the chosen columns with one term exchanged for another, and the steps; unchanged where
    no exchange is better.

    A term is exchanged for one that explains clearly more, by a partial F ratio of ``F_IN``: the
    term may have entered because of an effect that a later term explains better. A term is also
    exchanged for a simpler one that does not explain significantly less: ``beta*mach`` for ``beta``
    if mach hardly changes, or ``rudder^3`` for ``rudder`` after pulses of one size.
    """
    needed = _required_columns(products.terms, chosen, above)
    swaps = []
    for removed in (i for i in chosen if i not in needed):
        others = [i for i in chosen if i != removed]
        gains, sse = gains_of(products, others)
        gains = np.where([required.issubset(others) for required in above], gains, 0.0)
        added = _first_best_column(gains)
        if gains[added] > (1.0 + EQUAL_GAIN_TOLERANCE) * gains[removed]:
            more = partial_f_ratio(
                products, gains[added] - gains[removed], sse - gains[added], len(chosen)
            )
            swaps += [(more, removed, added)] if more > F_IN else []
        for added in _simpler_columns(products.terms, removed):
            less = partial_f_ratio(
                products, gains[removed] - gains[added], sse - gains[removed], len(chosen)
            )
            swaps += [(-less, removed, added)] if less < LARGEST_SIMPLER_F_RATIO else []
    if not swaps:
        return chosen, []
    _, removed, added = max(swaps)
    both, exchanged = [*chosen, added], [i for i in [*chosen, added] if i != removed]
    losses, sse = losses_of(products, exchanged)
    added_ratio = partial_f_ratio(products, losses[-1], sse, len(exchanged))
    losses, sse = losses_of(products, both)
    removed_ratio = partial_f_ratio(products, losses[both.index(removed)], sse, len(both))
    return exchanged, [
        _selection_step(products, both, added, True, added_ratio),
        _selection_step(products, exchanged, removed, False, removed_ratio),
    ]


def _simpler_columns(terms: Sequence[Term], at: int) -> list[int]:
    """Return the columns of terms with only some signals of term ``at`` and of its parents."""
    term, above = terms[at], parents(terms[at])
    return [
        i
        for i, each in enumerate(terms)
        if each.factors and (each.signals < term.signals or each in above)
    ]


def _parent_columns(terms: Sequence[Term], hierarchical: bool) -> list[frozenset[int]]:
    """Return for each term the columns of its offered parents; none unless ``hierarchical``."""
    if not hierarchical:
        return [frozenset()] * len(terms)
    at = {term: i for i, term in enumerate(terms)}
    return [frozenset(at[each] for each in parents(term) if each in at) for term in terms]


def _linear_columns(terms: Sequence[Term], axis: str) -> list[int]:
    """Return the columns of the linear terms that the symmetry of the aircraft allows, except Mach
    number, which hardly changes in a maneuver.
    """
    return [i for i, each in enumerate(terms) if is_linear(each, axis) and each.signals != {"mach"}]


def _required_columns(
    terms: Sequence[Term], chosen: Sequence[int], above: Sequence[frozenset[int]]
) -> set[int]:
    """Return the chosen columns that must stay: the constant, and parents of other terms."""
    return {i for i in chosen if not terms[i].factors}.union(*(above[i] for i in chosen))


def _without_weak(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    hierarchical: bool,
) -> tuple[list[int], list[SelectionStep]]:
    """Return the columns and steps without the terms whose F ratio is small for coloured residuals.

    The partial F ratios of the search are those for white residuals. The residuals are assumed to
    have the same variance everywhere, since a short maneuver hardly shows where they are larger.
    """
    above = _parent_columns(products.terms, hierarchical)
    while True:
        values = values_of(products, chosen)
        variance = np.diag(columns.covariance(products, chosen, values, rows, local=False))
        ratios = values**2 / np.maximum(variance, 1e-300)
        needed = _required_columns(products.terms, chosen, above)
        weak = [(F, i) for F, i in zip(ratios, chosen, strict=True) if i not in needed and F < F_IN]
        if not weak:
            return chosen, steps
        F, removed = min(weak)
        chosen = [i for i in chosen if i != removed]
        steps = [*steps, _selection_step(products, chosen, removed, False, float(F))]


def _with_confounders(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    axis: str,
) -> tuple[list[int], list[SelectionStep]]:
    """Return the columns and steps with the confounders: linear terms that are too weak for the
    search, but change the values of other linear terms.

    Without them these values have a bias that the standard deviations do not contain [1]_.

    References
    ----------
    .. [1] R. M. Mickey and S. Greenland, The impact of confounder selection criteria on effect
       estimation, American Journal of Epidemiology 129(1), 1989.
    """
    offered = _linear_columns(products.terms, axis)
    while True:
        gains, _ = gains_of(products, chosen)
        values = values_of(products, chosen)
        sigma = np.sqrt(np.diag(columns.covariance(products, chosen, values, rows)))
        is_linear_term = np.array([i in offered for i in chosen])
        confounders = []
        for candidate in (i for i in offered if i not in chosen and gains[i] > 0.0):
            extended = [*chosen, candidate]
            extended_values = values_of(products, extended)
            variance = np.diag(columns.covariance(products, extended, extended_values, rows))[-1]
            F = float(extended_values[-1] ** 2 / max(variance, 1e-300))
            changes = np.abs(extended_values[:-1] - values) / np.maximum(sigma, 1e-300)
            change = float(np.max(changes, where=is_linear_term, initial=0.0))
            if (
                change > (NOTABLE_CHANGE if F > CLEAR_F_RATIO else LARGE_CHANGE)
                or change**2 > LARGEST_VARIANCE_INFLATION * F
            ):
                confounders.append((change, F, candidate))
        if not confounders:
            return chosen, steps
        _, F, candidate = max(confounders)
        chosen = [*chosen, candidate]
        steps = [*steps, _selection_step(products, chosen, candidate, True, F)]


def orthogonal(products: Products) -> tuple[list[int], list[SelectionStep]]:
    """Return the columns whose orthogonal functions minimise the predicted squared error, and the
    steps.
    """
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    best, kept, steps = math.inf, list(chosen), []
    counted = 0
    most = min(len(products.terms), int(products.counts.sum()) // 4)
    while len(chosen) < most:
        gains, sse = gains_of(products, chosen)
        place = _first_best_column(gains)
        if not gains[place] > 0.0:
            break
        F = partial_f_ratio(products, gains[place], sse - gains[place], len(chosen) + 1)
        chosen = [*chosen, place]
        steps.append(_selection_step(products, chosen, place, True, F))
        if steps[-1].pse < best:
            best, kept, counted = steps[-1].pse, list(chosen), len(steps)
        elif len(steps) > counted + _STEPS_PAST_MINIMUM:
            break
    return kept, steps[:counted]


def _first_best_column(gains: np.ndarray) -> int:
    """Return the first column whose gain equals the largest one within rounding. Simple terms are
    offered first: if a signal is constant, its product with another signal is a multiple of the
    latter.
    """
    return int(np.argmax(gains >= (1.0 - EQUAL_GAIN_TOLERANCE) * np.max(gains)))


def select(
    histories: Sequence[Histories],
    axis: str,
    terms: Sequence[Term],
    method: str = STEPWISE,
    further: Sequence[Term] = (),
    columns: TermColumns | None = None,
    *,
    hierarchical: bool = False,
    baseline: bool = False,
) -> Selection:
    """Return the terms of one coefficient.

    Parameters
    ----------
    histories : of all maneuvers.
    axis : name of the coefficient.
    terms : the offered terms, the constant first.
    method : ``stepwise`` or ``orthogonal``.
    further : terms that are not offered. If the residual is larger than the noise, those that would
        explain it are reported as lacking.
    columns : columns of ``terms``; None computes them.
    hierarchical : see ``stepwise``.
    baseline : whether the coefficient is an increment to a model with the linear terms, so that
        these need not enter first.

    Returns
    -------
    Selection. Its standard deviations include residuals that are not white [1]_ and the uncertain
    choice of terms.

    References
    ----------
    .. [1] E. A. Morelli and V. Klein, Accuracy of aerodynamic model parameters estimated from
       flight test data, Journal of Guidance, Control, and Dynamics 20(1), 1997.
    """
    columns = TermColumns.of(histories, axis, terms) if columns is None else columns
    products = columns.products(histories, axis)
    rows = [h.coefficients[axis] for h in histories]
    noise_squares = _noise_squares(histories, axis, {})
    linear = _linear_columns(terms, axis)
    for _ in range(2):  # the values of the first round give the effect of noise in the signals
        products = replace(products, noise=noise_squares)
        if method == STEPWISE:
            first = () if baseline else linear
            chosen, steps = stepwise(products, first=first, hierarchical=hierarchical)
            chosen, steps = _without_weak(products, chosen, steps, columns, rows, hierarchical)
            strong = len(chosen)
            chosen, steps = _with_confounders(products, chosen, steps, columns, rows, axis)
        else:
            chosen, steps = orthogonal(products)
            strong = len(chosen)
        values, held = values_of(products, chosen), cross_validated_r2(products, chosen)
        table = dict(zip([terms[i] for i in chosen], values.tolist(), strict=True))
        noise_squares = _noise_squares(histories, axis, table)
    residuals = columns.residuals(rows, chosen, values)
    losses, sum_of_squares = losses_of(products, chosen)
    covariance, other = _reported_covariance(products, chosen, values, columns, rows, linear)
    sse = sum(float(e @ e) for e in residuals)
    n = float(products.counts.sum())
    noise, rms = math.sqrt(noise_squares / n), math.sqrt(sse / max(n - len(chosen), 1.0))
    alternative = None
    if other is not None:
        added, removed = (None if i is None else terms[i] for i in (other.added, other.removed))
        alternative = (added, removed, other.probability)
    selection = Selection(
        axis,
        method,
        tuple(steps),
        tuple(terms[i] for i in chosen),
        values,
        np.sqrt(np.diag(covariance)),
        covariance,
        np.array([partial_f_ratio(products, loss, sum_of_squares, len(chosen)) for loss in losses]),
        1.0 - sse / products.spread if products.spread > 0.0 else 0.0,
        held,
        rms,
        noise,
        confounders=tuple(terms[i] for i in chosen[strong:]),
        alternative=alternative,
    )
    if not further or rms < LARGE_RESIDUAL_RATIO * noise:
        return selection
    return _with_lacking(selection, histories, further, products.spread)


def _reported_covariance(
    products: Products,
    chosen: list[int],
    values: np.ndarray,
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    linear: Sequence[int],
) -> tuple[np.ndarray, Alternative | None]:
    """Return the covariance of the values, averaged over models that explain the data almost as
    well, and the most probable other model if it increases a standard deviation notably.
    """
    local_covariance, even_covariance = (
        columns.covariance(products, chosen, values, rows, local=local, unbiased=True)
        for local in (True, False)
    )
    constituents = [_simpler_columns(products.terms, i) for i in range(len(products.terms))]
    return averaged_covariance(
        products, chosen, local_covariance, np.diag(even_covariance), linear, constituents
    )


def _noise_squares(histories: Sequence[Histories], axis: str, table: Mapping[Term, float]) -> float:
    """Return the sum of squares due to sensor noise, in the coefficient ``axis`` and in the signals
    of its terms. ``table`` maps the terms to their values.
    """
    return sum(float(np.sum(h.sigma[axis] ** 2 + h.noise_variance(table, axis))) for h in histories)


def _with_lacking(
    selection: Selection, histories: Sequence[Histories], further: Sequence[Term], spread: float
) -> Selection:
    """Return the selection with the terms that were not offered and explain its residual best."""
    all_terms = (*selection.terms, *further)
    axis, count = selection.axis, len(selection.terms)
    products = TermColumns.of(histories, axis, all_terms).products(histories, axis)
    gains, sse = gains_of(products, list(range(count)))
    significant = [
        (
            all_terms[i],
            partial_f_ratio(products, gains[i], sse - gains[i], count + 1),
            gains[i] / sse,
        )
        for i in np.argsort(gains)[::-1][:_MOST_LACKING]
        if gains[i] > _LEAST_LACKING_SHARE * sse and gains[i] > 0.1 * LEAST_VARIANCE_SHARE * spread
    ]
    return replace(selection, lacking=tuple(entry for entry in significant if entry[1] > F_IN))


def _selection_step(
    products: Products, chosen: list[int], place: int, added: bool, F: float
) -> SelectionStep:
    n, sse = float(products.counts.sum()), losses_of(products, chosen)[1]
    spread = max(products.spread, 1e-300)
    pse = sse / n + spread / n * len(chosen) / n
    held = cross_validated_r2(products, chosen)
    return SelectionStep(products.terms[place], added, F, 1.0 - sse / spread, pse, held)
