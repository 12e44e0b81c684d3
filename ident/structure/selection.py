"""Terms of a coefficient chosen by stepwise regression or by orthogonal functions.

Both work on the products of all columns summed over each maneuver, so that fifty maneuvers cost as
much as one, and whole maneuvers are left out by subtraction. Stepwise regression adds the term with
the largest partial F ratio while that exceeds a threshold, and removes terms whose ratio falls
below it [1]_; where none enters, a term is exchanged for one that explains clearly more in its
place [3]_. The orthogonal functions are those of the offered terms, each made orthogonal to the
ones before it; they enter in the order of what they explain, as many as make the predicted squared
error

    PSE = SSE / N + s2_max n / N,   s2_max = sum (z - mean z)^2 / N

smallest [2]_.

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
    columns_of,
    covariance_of,
    gains_of,
    held_out_of,
    losses_of,
    noise_columns,
    products_of,
    ratio_of,
    values_of,
)
from sim.aerodynamics import Term, is_linear, parents

F_IN = 20.0  # partial F ratio: Klein and Morelli, section 5.4, for many samples
LEAST_VARIANCE_SHARE = 2e-4  # share of the variance that a term has to explain
NO_WORSE = 4.0  # partial F ratio, two sigmas, by which a simpler term may explain less
CHANGED, MUCH = 1.0, 2.0  # sigmas by which a linear term that is clear, or any, moves another value
CLEAR_F_RATIO = 5.0  # partial F ratio of such a term
# variance inflation factor above which two terms are not told apart
LARGEST_VARIANCE_INFLATION = 10.0
# largest relative difference of equal gains: of two such terms the one offered first enters
AS_GOOD = 1e-6
STEPWISE, ORTHOGONAL = "stepwise", "orthogonal"


@dataclass(frozen=True)
class SelectionStep:
    """One step of a selection.

    Attributes
    ----------
    term : that came or went.
    added : False where it went.
    F : its partial F ratio.
    r2 : of the model after the step.
    pse : predicted squared error.
    held_out : R2 on maneuvers left out, each predicted by the others; NaN with one maneuver.
    """

    term: Term
    added: bool
    F: float
    r2: float
    pse: float
    held_out: float


@dataclass(frozen=True, eq=False)
class TermColumns:
    """Values of terms by maneuver, as they go with the forces or with the moments.

    Attributes
    ----------
    terms : k.
    blocks : ``(M, k)`` by maneuver.
    noises : ``(s, M, k)``, see `noise_columns`.
    """

    terms: tuple[Term, ...]
    blocks: Sequence[np.ndarray]
    noises: Sequence[np.ndarray]

    @classmethod
    def of(cls, histories: Sequence[Histories], axis: str, terms: Sequence[Term]) -> TermColumns:
        """Return the term columns of histories, for the coefficient ``axis``, all averaged
        alike.
        """
        blocks = [columns_of(h, terms, axis) for h in histories]
        return cls(tuple(terms), blocks, [noise_columns(h, terms) for h in histories])

    def products(self, histories: Sequence[Histories], axis: str) -> Products:
        """Sums of products with the coefficient ``axis``, and what noise adds to them."""
        rows = [h.coefficients[axis] for h in histories]
        own = [h.coefficient_noise(axis) for h in histories]
        pairs = list(zip(self.noises, own, strict=True))
        return products_of(self.blocks, rows, self.terms, pairs)

    def residuals(
        self, rows: Sequence[np.ndarray], chosen: Sequence[int], values: np.ndarray
    ) -> list[np.ndarray]:
        """Return the residuals of the coefficient ``rows`` after the chosen columns, by
        maneuver.
        """
        pairs = zip(rows, self.blocks, strict=True)
        return [row - block[:, chosen] @ values for row, block in pairs]

    def covariance(
        self,
        products: Products,
        chosen: Sequence[int],
        values: np.ndarray,
        rows: Sequence[np.ndarray],
        *,
        local: bool = True,
        unbiased: bool = False,
    ) -> np.ndarray:
        """Return the covariance of the values, ``(n, n)``; see `covariance_of`."""
        parts = [block[:, chosen] for block in self.blocks]
        noise = products.gram_noise[:, chosen][:, :, chosen]
        drifts = (products.cross_noise[:, chosen] - noise @ values) / products.counts[:, None]
        residuals = self.residuals(rows, chosen, values)
        noises = noise.sum(axis=0)
        return covariance_of(parts, residuals, drifts, noises, local=local, unbiased=unbiased)


@dataclass(frozen=True, eq=False)
class Selection:
    """The terms chosen for a coefficient.

    Attributes
    ----------
    axis : its name.
    method : ``stepwise`` or ``orthogonal``.
    steps : in order.
    terms, values, sigma : chosen, ``(n,)``.
    covariance : ``(n, n)``.
    ratios : partial F ratio of each beside all others, ``(n,)``.
    r2, held_out : of the chosen model.
    rms : of the residual.
    noise : rms of the noise that the sensors explain.
    lacking : terms that were not offered and would explain the residual, with their F ratios.
    confounders : weak terms that were chosen because the values of others depend on them.
    alternative : terms added and removed in another model that makes standard deviations clearly
        larger, and its probability.
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
        """Residual over noise."""
        return self.rms / self.noise if self.noise > 0.0 else math.inf


def stepwise(
    products: Products, *, first: Sequence[int] = (), hierarchical: bool = False
) -> tuple[list[int], list[SelectionStep]]:
    """Return the columns chosen by stepwise regression, and the steps.

    Parameters
    ----------
    products : the constant term's column, if offered, begins in the model.
    first : columns that enter before the others, whatever they explain: two terms that mask each
        other explain little alone. They leave as all terms do.
    hierarchical : a product enters after the linear terms of its symmetry, where they are offered.

    A term enters with a partial F ratio of at least ``F_IN``, and if it explains
    ``LEAST_VARIANCE_SHARE`` of the variance; ``OF_RESIDUAL`` of it is enough while the residual is
    above ``LARGE_RESIDUAL_RATIO`` times the noise.
    """
    above = _parents(products.terms, hierarchical)
    chosen, steps = _entered(products, first)
    seen: set[frozenset[int]] = set()
    chosen = _supported(products, chosen, steps, above, F_IN, LEAST_VARIANCE_SHARE)
    while frozenset(chosen) not in seen:
        seen.add(frozenset(chosen))
        gains, sse = gains_of(products, chosen)
        gains = np.where([each.issubset(chosen) for each in above], gains, 0.0)
        best = _best(gains) if len(gains) else -1
        F = ratio_of(products, gains[best], sse - gains[best], len(chosen) + 1)
        if best < 0 or F_IN > F or gains[best] < products.least_gain(LEAST_VARIANCE_SHARE, sse):
            chosen, exchanged = _exchanged(products, chosen, above, F_IN)
            steps += exchanged
            continue
        chosen = [*chosen, best]
        steps.append(_step(products, chosen, best, True, F))
        chosen = _supported(products, chosen, steps, above, F_IN, LEAST_VARIANCE_SHARE)
    return chosen, steps


def _entered(products: Products, first: Sequence[int]) -> tuple[list[int], list[SelectionStep]]:
    """Return the constant and the columns ``first``, those that explain most before the others;
    without those whose own part is mostly noise.
    """
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    steps: list[SelectionStep] = []
    while True:
        gains, sse = gains_of(products, chosen)
        gains = np.where(np.isin(np.arange(len(gains)), first), gains, 0.0)
        best = _best(gains) if len(gains) else -1
        if best < 0 or not gains[best] > 0.0:
            return chosen, steps
        F = ratio_of(products, gains[best], sse - gains[best], len(chosen) + 1)
        chosen = [*chosen, best]
        steps.append(_step(products, chosen, best, True, F))


def _supported(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    above: Sequence[frozenset[int]],
    f_in: float,
    least: float,
) -> list[int]:
    """Return the chosen columns without those that explain too little; ``steps`` is continued."""
    while len(chosen) > 2:
        losses, sse = losses_of(products, chosen)
        needed = _needed(products.terms, chosen, above)
        losses = [math.inf if i in needed else loss for i, loss in zip(chosen, losses, strict=True)]
        worst = int(np.argmin(losses))
        F = ratio_of(products, losses[worst], sse, len(chosen))
        if f_in <= F and losses[worst] >= 0.5 * products.least_gain(least, sse):
            break
        gone = chosen[worst]
        chosen = [i for i in chosen if i != gone]
        steps.append(_step(products, chosen, gone, False, F))
    return chosen


def _exchanged(
    products: Products, chosen: list[int], above: Sequence[frozenset[int]], f_in: float
) -> tuple[list[int], list[SelectionStep]]:
    """Return one term in the place of another, by partial F ratios in what the rest leaves.

    It explains clearly more, by ``f_in``: a term may have entered for what others explain that came
    later. Or it is simpler and explains no less but for noise: ``beta`` for ``beta*mach`` where
    mach hardly moves, ``rudder`` for ``rudder^3`` after pulses of one size.
    """
    needed = _needed(products.terms, chosen, above)
    swaps = []
    for gone in (i for i in chosen if i not in needed):
        rest = [i for i in chosen if i != gone]
        gains, sse = gains_of(products, rest)
        gains = np.where([each.issubset(rest) for each in above], gains, 0.0)
        come = _best(gains)
        if gains[come] > (1.0 + AS_GOOD) * gains[gone]:
            more = ratio_of(products, gains[come] - gains[gone], sse - gains[come], len(chosen))
            swaps += [(more, gone, come)] if more > f_in else []
        for come in _simpler(products.terms, gone):
            less = ratio_of(products, gains[gone] - gains[come], sse - gains[gone], len(chosen))
            swaps += [(-less, gone, come)] if less < NO_WORSE else []
    if not swaps:
        return chosen, []
    _, gone, come = max(swaps)
    both, last = [*chosen, come], [i for i in [*chosen, come] if i != gone]
    losses, sse = losses_of(products, last)
    own = ratio_of(products, losses[-1], sse, len(last))
    losses, sse = losses_of(products, both)
    beside = ratio_of(products, losses[both.index(gone)], sse, len(both))
    return last, [
        _step(products, both, come, True, own),
        _step(products, last, gone, False, beside),
    ]


def _simpler(terms: Sequence[Term], at: int) -> list[int]:
    """Return the terms made of some of the signals of another one, and its linear parents."""
    term, above = terms[at], parents(terms[at])
    return [
        i
        for i, each in enumerate(terms)
        if each.factors and (each.signals < term.signals or each in above)
    ]


def _parents(terms: Sequence[Term], hierarchical: bool) -> list[frozenset[int]]:
    """Columns of each term's parents among those offered; where not ``hierarchical`` none."""
    if not hierarchical:
        return [frozenset()] * len(terms)
    at = {term: i for i, term in enumerate(terms)}
    return [frozenset(at[each] for each in parents(term) if each in at) for term in terms]


def _linear(terms: Sequence[Term], axis: str) -> list[int]:
    """Return the columns of linear terms that the symmetry of the aircraft allows; Mach number is
    none, as it hardly moves.
    """
    return [i for i, each in enumerate(terms) if is_linear(each, axis) and each.signals != {"mach"}]


def _needed(
    terms: Sequence[Term], chosen: Sequence[int], above: Sequence[frozenset[int]]
) -> set[int]:
    """Return the columns that stay: the constant, and parents of others."""
    return {i for i in chosen if not terms[i].factors}.union(*(above[i] for i in chosen))


def _without_weak(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    hierarchical: bool,
) -> tuple[list[int], list[SelectionStep]]:
    """Drop the terms whose F ratio is small by standard deviations for coloured residuals of one
    variance (a short maneuver says little of where they are larger).

    The partial F ratios of the search take residuals as white.
    """
    above = _parents(products.terms, hierarchical)
    while True:
        values = values_of(products, chosen)
        variance = np.diag(columns.covariance(products, chosen, values, rows, local=False))
        ratios = values**2 / np.maximum(variance, 1e-300)
        needed = _needed(products.terms, chosen, above)
        weak = [(F, i) for F, i in zip(ratios, chosen, strict=True) if i not in needed and F < F_IN]
        if not weak:
            return chosen, steps
        F, gone = min(weak)
        chosen = [i for i in chosen if i != gone]
        steps = [*steps, _step(products, chosen, gone, False, float(F))]


def _with_confounders(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    axis: str,
) -> tuple[list[int], list[SelectionStep]]:
    """Add the linear terms that are too weak for the search and change the values of other linear
    ones.

    Left out, they would be a bias of those values that no standard deviation holds [1]_.

    References
    ----------
    .. [1] R. M. Mickey and S. Greenland, The impact of confounder selection criteria on effect
       estimation, American Journal of Epidemiology 129(1), 1989.
    """
    offered = _linear(products.terms, axis)
    while True:
        gains, _ = gains_of(products, chosen)
        values = values_of(products, chosen)
        sigma = np.sqrt(np.diag(columns.covariance(products, chosen, values, rows)))
        asked = np.array([i in offered for i in chosen])
        found = []
        for come in (i for i in offered if i not in chosen and gains[i] > 0.0):
            more = [*chosen, come]
            full = values_of(products, more)
            variance = np.diag(columns.covariance(products, more, full, rows))[-1]
            F = float(full[-1] ** 2 / max(variance, 1e-300))
            moved = np.abs(full[:-1] - values) / np.maximum(sigma, 1e-300)
            change = float(np.max(moved, where=asked, initial=0.0))
            if (
                change > (CHANGED if F > CLEAR_F_RATIO else MUCH)
                or change**2 > LARGEST_VARIANCE_INFLATION * F
            ):
                found.append((change, F, come))
        if not found:
            return chosen, steps
        _, F, come = max(found)
        chosen = [*chosen, come]
        steps = [*steps, _step(products, chosen, come, True, F)]


def orthogonal(products: Products) -> tuple[list[int], list[SelectionStep]]:
    """Columns whose orthogonal functions make the predicted squared error least, and the steps."""
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    best, kept, steps = math.inf, list(chosen), []
    counted = 0
    most = min(len(products.terms), int(products.counts.sum()) // 4)
    while len(chosen) < most:
        gains, sse = gains_of(products, chosen)
        place = _best(gains)
        if not gains[place] > 0.0:
            break
        F = ratio_of(products, gains[place], sse - gains[place], len(chosen) + 1)
        chosen = [*chosen, place]
        steps.append(_step(products, chosen, place, True, F))
        if steps[-1].pse < best:
            best, kept, counted = steps[-1].pse, list(chosen), len(steps)
        elif len(steps) > counted + 3:
            break
    return kept, steps[:counted]


def _best(gains: np.ndarray) -> int:
    """Return the first column whose gain is the largest but for rounding: simple terms are offered
    first, and where one signal stands still its product with another is that other's multiple.
    """
    return int(np.argmax(gains >= (1.0 - AS_GOOD) * np.max(gains)))


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
    axis : the coefficient.
    terms : offered; the constant first.
    method : ``stepwise`` or ``orthogonal``.
    further : terms that are not offered, by which a residual is explained that is larger than the
        noise.
    columns : of ``terms`` where they are known.
    hierarchical : see ``stepwise``.
    baseline : increments to a model that has the linear terms, which then need not enter first.

    Returns
    -------
    Selection, its standard deviations corrected for residuals that are not white [1]_ and for the
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
    linear = _linear(terms, axis)
    for _ in range(2):  # the noise of the signals is known when terms have values
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
        values, held = values_of(products, chosen), held_out_of(products, chosen)
        table = dict(zip([terms[i] for i in chosen], values.tolist(), strict=True))
        noise_squares = _noise_squares(histories, axis, table)
    residuals = columns.residuals(rows, chosen, values)
    losses, left = losses_of(products, chosen)
    covariance, other = _reported_covariance(products, chosen, values, columns, rows, linear)
    sse = sum(float(e @ e) for e in residuals)
    n = float(products.counts.sum())
    noise = math.sqrt(noise_squares / n)
    rms = math.sqrt(sse / max(n - len(chosen), 1.0))
    found = Selection(
        axis,
        method,
        tuple(steps),
        tuple(terms[i] for i in chosen),
        values,
        np.sqrt(np.diag(covariance)),
        covariance,
        np.array([ratio_of(products, loss, left, len(chosen)) for loss in losses]),
        1.0 - sse / products.spread if products.spread > 0.0 else 0.0,
        held,
        rms,
        noise,
        confounders=tuple(terms[i] for i in chosen[strong:]),
        alternative=None if other is None else _as_terms(other, terms),
    )
    if not further or rms < LARGE_RESIDUAL_RATIO * noise:
        return found
    return _with_lacking(found, histories, further, products.spread)


def _reported_covariance(
    products: Products,
    chosen: list[int],
    values: np.ndarray,
    columns: TermColumns,
    rows: Sequence[np.ndarray],
    linear: Sequence[int],
) -> tuple[np.ndarray, Alternative | None]:
    """Return the covariance of the values over the models that explain the data as well, and the
    likeliest other model where it matters.
    """
    whole, even = (
        columns.covariance(products, chosen, values, rows, local=local, unbiased=True)
        for local in (True, False)
    )
    constituents = [_simpler(products.terms, i) for i in range(len(products.terms))]
    return averaged_covariance(products, chosen, whole, np.diag(even), linear, constituents)


def _as_terms(other: Alternative, terms: Sequence[Term]) -> tuple[Term | None, Term | None, float]:
    added, removed = (None if i is None else terms[i] for i in (other.added, other.removed))
    return added, removed, other.probability


def _noise_squares(histories: Sequence[Histories], axis: str, table: Mapping[Term, float]) -> float:
    """Sum of squares that the noise of the sensors explains, that of the terms' signals as well."""
    return sum(float(np.sum(h.sigma[axis] ** 2 + h.noise_variance(table, axis))) for h in histories)


def _with_lacking(
    found: Selection,
    histories: Sequence[Histories],
    further: Sequence[Term],
    spread: float,
) -> Selection:
    """Return the same with the terms, not offered, that explain the residual best."""
    every = (*found.terms, *further)
    products = TermColumns.of(histories, found.axis, every).products(histories, found.axis)
    gains, sse = gains_of(products, list(range(len(found.terms))))
    significant = [
        (
            every[i],
            ratio_of(products, gains[i], sse - gains[i], len(found.terms) + 1),
            gains[i] / sse,
        )
        for i in np.argsort(gains)[::-1][:3]
        if gains[i] > 0.03 * sse and gains[i] > 0.1 * LEAST_VARIANCE_SHARE * spread
    ]
    return replace(found, lacking=tuple(each for each in significant if each[1] > F_IN))


def _step(
    products: Products, chosen: list[int], place: int, added: bool, F: float
) -> SelectionStep:
    n, sse = float(products.counts.sum()), losses_of(products, chosen)[1]
    spread = max(products.spread, 1e-300)
    pse = sse / n + spread / n * len(chosen) / n
    held = held_out_of(products, chosen)
    return SelectionStep(products.terms[place], added, F, 1.0 - sse / spread, pse, held)
