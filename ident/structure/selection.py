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

from ident.structure.coefficients import Histories
from sim.aerodynamics import Term, parents

F_IN = 20.0  # partial F ratio: Klein and Morelli, section 5.4, for many samples
LEAST = 2e-4  # share of the variance that a term has to explain
LARGE = 1.3  # residual over noise, above which a share of the residual is enough
OF_RESIDUAL = 0.02  # that share
ALIKE = 1e-9  # share of a column that the others leave, below which it is no column of its own
NO_WORSE = 4.0  # partial F ratio, two sigmas, by which a simpler term may explain less
AS_GOOD = 1e-6  # of a gain, within which two terms explain the same: the one offered first enters
_LAGS = 8  # of windows that overlap by half
STEPWISE, ORTHOGONAL = "stepwise", "orthogonal"


@dataclass(frozen=True, eq=False)
class Products:
    """Sums of products over maneuvers: of all columns with each other and with the coefficient.

    Attributes
    ----------
    terms : k columns. gram : ``(g, k, k)`` by maneuver; cross : ``(g, k)`` with the coefficient;
        total, squares : ``(g,)`` its sum and sum of squares; counts : ``(g,)`` samples.
    noise : sum of squares that the sensors' noise explains; infinite where it is unknown.
    """

    terms: tuple[Term, ...]
    gram: np.ndarray
    cross: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    noise: float = math.inf

    def least_gain(self, least: float, sse: float) -> float:
        """Sum of squares that a term has to explain where ``sse`` is left: ``least`` of the
        variance, or less while the residual is clearly larger than the noise.
        """
        of_variance = least * self.spread
        return min(of_variance, OF_RESIDUAL * sse) if sse > LARGE**2 * self.noise else of_variance

    @property
    def spread(self) -> float:
        """Sum of squares about the mean, over all maneuvers."""
        n = float(self.counts.sum())
        return float(self.squares.sum()) - float(self.total.sum()) ** 2 / n


@dataclass(frozen=True)
class SelectionStep:
    """One step of a selection.

    Attributes
    ----------
    term : that came or went. added : False where it went. F : its partial F ratio.
    r2 : of the model after the step. pse : predicted squared error. held_out : R2 on maneuvers left
        out, each predicted by the others; NaN with one maneuver.
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
    axis : its name. method : ``stepwise`` or ``orthogonal``. steps : in order.
    terms, values, sigma : chosen, ``(n,)``. covariance : ``(n, n)``.
    r2, held_out : of the chosen model. rms : of the residual. noise : rms of the noise that the
        sensors explain.
    lacking : terms that were not offered and would explain the residual, with their F ratios.
    """

    axis: str
    method: str
    steps: tuple[SelectionStep, ...]
    terms: tuple[Term, ...]
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    r2: float
    held_out: float
    rms: float
    noise: float
    lacking: tuple[tuple[Term, float, float], ...] = ()

    @property
    def table(self) -> dict[Term, float]:
        """Values by term."""
        return dict(zip(self.terms, self.values.tolist(), strict=True))

    @property
    def ratio(self) -> float:
        """Residual over noise."""
        return self.rms / self.noise if self.noise > 0.0 else math.inf


def columns_of(history: Histories, terms: Sequence[Term], axis: str) -> np.ndarray:
    """Averaged values of terms, ``(M, k)``, as they go with a coefficient."""
    return np.stack([history.column(term, axis) for term in terms], axis=1)


def products_of(
    blocks: Sequence[np.ndarray], rows: Sequence[np.ndarray], terms: Sequence[Term]
) -> Products:
    """Products of columns ``(M, k)`` and a coefficient ``(M,)``, by maneuver."""
    return Products(
        tuple(terms),
        np.array([block.T @ block for block in blocks]),
        np.array([block.T @ row for block, row in zip(blocks, rows, strict=True)]),
        np.array([row.sum() for row in rows]),
        np.array([row @ row for row in rows]),
        np.array([len(row) for row in rows]),
    )


def stepwise(
    products: Products, f_in: float = F_IN, least: float = LEAST, *, hierarchical: bool = False
) -> tuple[list[int], list[SelectionStep]]:
    """Columns chosen by stepwise regression, and the steps.

    Parameters
    ----------
    products : the constant term's column, if offered, begins in the model.
    f_in : least partial F ratio of a term. least : share of the variance that it explains at least;
        while the residual is above ``LARGE`` times the noise, ``OF_RESIDUAL`` of it is enough.
    hierarchical : a product enters after the linear terms of its symmetry, where they are offered.
    """
    above = _parents(products.terms) if hierarchical else [frozenset()] * len(products.terms)
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    steps: list[SelectionStep] = []
    seen: set[frozenset[int]] = set()
    while frozenset(chosen) not in seen:
        seen.add(frozenset(chosen))
        gains, sse = _gains(products, chosen)
        gains = np.where([each.issubset(chosen) for each in above], gains, 0.0)
        best = _best(gains) if len(gains) else -1
        F = _ratio(products, gains[best], sse - gains[best], len(chosen) + 1)
        if best < 0 or f_in > F or gains[best] < products.least_gain(least, sse):
            chosen, exchanged = _exchanged(products, chosen, above, f_in)
            steps += exchanged
            continue
        chosen = [*chosen, best]
        steps.append(_step(products, chosen, best, True, F))
        while len(chosen) > 2:
            losses, sse = _losses(products, chosen)
            needed = _needed(products.terms, chosen, above)
            losses = [
                math.inf if i in needed else loss for i, loss in zip(chosen, losses, strict=True)
            ]
            worst = int(np.argmin(losses))
            F = _ratio(products, losses[worst], sse, len(chosen))
            if f_in <= F and losses[worst] >= 0.5 * products.least_gain(least, sse):
                break
            gone = chosen[worst]
            chosen = [i for i in chosen if i != gone]
            steps.append(_step(products, chosen, gone, False, F))
    return chosen, steps


def _exchanged(
    products: Products, chosen: list[int], above: Sequence[frozenset[int]], f_in: float
) -> tuple[list[int], list[SelectionStep]]:
    """One term in the place of another, by partial F ratios in what the rest leaves.

    It explains clearly more, by ``f_in``: a term may have entered for what others explain that came
    later. Or it is simpler and explains no less but for noise: ``beta`` for ``beta*mach`` where
    mach hardly moves, ``rudder`` for ``rudder^3`` after pulses of one size.
    """
    needed = _needed(products.terms, chosen, above)
    swaps = []
    for gone in (i for i in chosen if i not in needed):
        rest = [i for i in chosen if i != gone]
        gains, sse = _gains(products, rest)
        gains = np.where([each.issubset(rest) for each in above], gains, 0.0)
        come = _best(gains)
        if gains[come] > (1.0 + AS_GOOD) * gains[gone]:
            more = _ratio(products, gains[come] - gains[gone], sse - gains[come], len(chosen))
            swaps += [(more, gone, come)] if more > f_in else []
        for come in _simpler(products.terms, gone):
            less = _ratio(products, gains[gone] - gains[come], sse - gains[gone], len(chosen))
            swaps += [(-less, gone, come)] if less < NO_WORSE else []
    if not swaps:
        return chosen, []
    _, gone, come = max(swaps)
    both, last = [*chosen, come], [i for i in [*chosen, come] if i != gone]
    losses, sse = _losses(products, last)
    own = _ratio(products, losses[-1], sse, len(last))
    losses, sse = _losses(products, both)
    beside = _ratio(products, losses[both.index(gone)], sse, len(both))
    return last, [
        _step(products, both, come, True, own),
        _step(products, last, gone, False, beside),
    ]


def _simpler(terms: Sequence[Term], at: int) -> list[int]:
    """Terms made of some of the signals of another one, and its linear parents."""
    term, above = terms[at], parents(terms[at])
    return [
        i
        for i, each in enumerate(terms)
        if each.factors and (each.signals < term.signals or each in above)
    ]


def _parents(terms: Sequence[Term]) -> list[frozenset[int]]:
    """Columns of each term's parents among those offered."""
    at = {term: i for i, term in enumerate(terms)}
    return [frozenset(at[each] for each in parents(term) if each in at) for term in terms]


def _needed(
    terms: Sequence[Term], chosen: Sequence[int], above: Sequence[frozenset[int]]
) -> set[int]:
    """Columns that stay: the constant, and parents of others."""
    return {i for i in chosen if not terms[i].factors}.union(*(above[i] for i in chosen))


def _without_weak(
    products: Products,
    chosen: list[int],
    steps: list[SelectionStep],
    blocks: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    hierarchical: bool,
) -> tuple[list[int], list[SelectionStep]]:
    """Without the terms whose F ratio is small by standard deviations for coloured residuals of one
    variance (a short maneuver says little of where they are larger).

    The partial F ratios of the search take residuals as white.
    """
    above = _parents(products.terms) if hierarchical else [frozenset()] * len(products.terms)
    while True:
        values = _solve(products, chosen)
        parts = [block[:, chosen] for block in blocks]
        residuals = [row - part @ values for row, part in zip(rows, parts, strict=True)]
        variance = np.diag(_covariance(parts, residuals, local=False))
        ratios = values**2 / np.maximum(variance, 1e-300)
        needed = _needed(products.terms, chosen, above)
        weak = [(F, i) for F, i in zip(ratios, chosen, strict=True) if i not in needed and F < F_IN]
        if not weak:
            return chosen, steps
        F, gone = min(weak)
        chosen = [i for i in chosen if i != gone]
        steps = [*steps, _step(products, chosen, gone, False, float(F))]


def orthogonal(products: Products) -> tuple[list[int], list[SelectionStep]]:
    """Columns whose orthogonal functions make the predicted squared error least, and the steps."""
    chosen = [i for i, term in enumerate(products.terms) if not term.factors]
    best, kept, steps = math.inf, list(chosen), []
    counted = 0
    most = min(len(products.terms), int(products.counts.sum()) // 4)
    while len(chosen) < most:
        gains, sse = _gains(products, chosen)
        place = _best(gains)
        if not gains[place] > 0.0:
            break
        F = _ratio(products, gains[place], sse - gains[place], len(chosen) + 1)
        chosen = [*chosen, place]
        steps.append(_step(products, chosen, place, True, F))
        if steps[-1].pse < best:
            best, kept, counted = steps[-1].pse, list(chosen), len(steps)
        elif len(steps) > counted + 3:
            break
    return kept, steps[:counted]


def _best(gains: np.ndarray) -> int:
    """The first column whose gain is the largest but for rounding: simple terms are offered first,
    and where one signal stands still its product with another is that other's multiple.
    """
    return int(np.argmax(gains >= (1.0 - AS_GOOD) * np.max(gains)))


def select(
    histories: Sequence[Histories],
    axis: str,
    terms: Sequence[Term],
    method: str = STEPWISE,
    further: Sequence[Term] = (),
    blocks: Sequence[np.ndarray] | None = None,
    *,
    hierarchical: bool = False,
) -> Selection:
    """The terms of one coefficient.

    Parameters
    ----------
    histories : of all maneuvers. axis : the coefficient. terms : offered; the constant first.
    method : ``stepwise`` or ``orthogonal``. further : terms that are not offered, by which a
        residual is explained that is larger than the noise.
    blocks : values of ``terms`` by maneuver where they are known. hierarchical : see ``stepwise``.

    Returns
    -------
    Selection, its standard deviations corrected for residuals that are not white [1]_.

    References
    ----------
    .. [1] E. A. Morelli and V. Klein, Accuracy of aerodynamic model parameters estimated from
       flight test data, Journal of Guidance, Control, and Dynamics 20(1), 1997.
    """
    blocks = [columns_of(h, terms, axis) for h in histories] if blocks is None else blocks
    rows = [h.coefficients[axis] for h in histories]
    products = products_of(blocks, rows, terms)
    noise_squares = _noise_squares(histories, axis, {})
    for _ in range(2):  # the noise of the signals is known when terms have values
        products = replace(products, noise=noise_squares)
        if method == STEPWISE:
            chosen, steps = stepwise(products, hierarchical=hierarchical)
            chosen, steps = _without_weak(products, chosen, steps, blocks, rows, hierarchical)
        else:
            chosen, steps = orthogonal(products)
        values, held = _solve(products, chosen), _held_out(products, chosen)
        table = dict(zip([terms[i] for i in chosen], values.tolist(), strict=True))
        noise_squares = _noise_squares(histories, axis, table)
    parts = [block[:, chosen] for block in blocks]
    residuals = [row - part @ values for row, part in zip(rows, parts, strict=True)]
    covariance = _covariance(parts, residuals)
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
        1.0 - sse / products.spread if products.spread > 0.0 else 0.0,
        held,
        rms,
        noise,
    )
    if not further or rms < LARGE * noise:
        return found
    return _with_lacking(found, histories, parts, rows, further, products.spread)


def _noise_squares(histories: Sequence[Histories], axis: str, table: Mapping[Term, float]) -> float:
    """Sum of squares that the noise of the sensors explains, that of the terms' signals as well."""
    return sum(float(np.sum(h.sigma[axis] ** 2 + h.noise_through(table, axis))) for h in histories)


def _with_lacking(
    found: Selection,
    histories: Sequence[Histories],
    parts: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    further: Sequence[Term],
    spread: float,
) -> Selection:
    """The same with the terms, not offered, that explain the residual best."""
    every = (*found.terms, *further)
    blocks = [
        np.hstack([part, columns_of(h, further, found.axis)])
        for part, h in zip(parts, histories, strict=True)
    ]
    products = products_of(blocks, rows, every)
    gains, sse = _gains(products, list(range(len(found.terms))))
    told = [
        (every[i], _ratio(products, gains[i], sse - gains[i], len(found.terms) + 1), gains[i] / sse)
        for i in np.argsort(gains)[::-1][:3]
        if gains[i] > 0.03 * sse and gains[i] > 0.1 * LEAST * spread
    ]
    return replace(found, lacking=tuple(each for each in told if each[1] > F_IN))


# ---- Least squares on sums of products


def _solve(products: Products, chosen: Sequence[int], without: int | None = None) -> np.ndarray:
    """Values of the chosen columns; without one maneuver where it is named."""
    gram, cross = products.gram.sum(axis=0), products.cross.sum(axis=0)
    if without is not None:
        gram, cross = gram - products.gram[without], cross - products.cross[without]
    part = gram[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
    found = np.linalg.lstsq(part / np.outer(scale, scale), cross[chosen] / scale, rcond=1e-12)[0]
    return np.asarray(found / scale)


def _gains(products: Products, chosen: Sequence[int]) -> tuple[np.ndarray, float]:
    """Sum of squares that each further column would explain, ``(k,)``, and what is left now."""
    gram, cross = products.gram.sum(axis=0), products.cross.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram, cross = gram / np.outer(scale, scale), cross / scale
    squares = float(products.squares.sum())
    if chosen:
        inverse = np.linalg.pinv(gram[np.ix_(chosen, chosen)], rcond=1e-12, hermitian=True)
        weights = inverse @ gram[chosen]
        left = 1.0 - np.einsum("ij,ij->j", gram[chosen], weights)
        part = cross - cross[chosen] @ weights
        sse = squares - float(cross[chosen] @ inverse @ cross[chosen])
    else:
        left, part, sse = np.ones(len(cross)), cross, squares
    gains = np.where(left > ALIKE, part**2 / np.maximum(left, ALIKE), 0.0)
    gains[list(chosen)] = 0.0
    return gains, max(sse, 0.0)


def _losses(products: Products, chosen: Sequence[int]) -> tuple[list[float], float]:
    """What each chosen column explains that the others do not, and what is left now."""
    values = _solve(products, chosen)
    part = products.gram.sum(axis=0)[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
    inverse = np.linalg.pinv(part / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    losses = (values * scale) ** 2 / np.maximum(np.diag(inverse), 1e-300)
    return losses.tolist(), _left(products, chosen)


def _left(products: Products, chosen: Sequence[int]) -> float:
    cross = products.cross.sum(axis=0)[chosen]
    return max(float(products.squares.sum()) - float(cross @ _solve(products, chosen)), 0.0)


def _ratio(products: Products, gain: float, sse: float, count: int) -> float:
    """Partial F ratio of a term."""
    freedom = float(products.counts.sum()) - count
    return float(gain / max(sse / max(freedom, 1.0), 1e-300))


def _step(
    products: Products, chosen: list[int], place: int, added: bool, F: float
) -> SelectionStep:
    n, sse = float(products.counts.sum()), _left(products, chosen)
    spread = max(products.spread, 1e-300)
    pse = sse / n + spread / n * len(chosen) / n
    held = _held_out(products, chosen)
    return SelectionStep(products.terms[place], added, F, 1.0 - sse / spread, pse, held)


def _held_out(products: Products, chosen: list[int]) -> float:
    """R2 of maneuvers that the others predict; NaN with one maneuver."""
    groups = len(products.counts)
    if groups < 2:
        return math.nan
    error = 0.0
    for g in range(groups):
        values = _solve(products, chosen, g)
        part = products.gram[g][np.ix_(chosen, chosen)]
        error += float(
            products.squares[g] - 2.0 * values @ products.cross[g][chosen] + values @ part @ values
        )
    return 1.0 - error / max(products.spread, 1e-300)


def _covariance(
    parts: Sequence[np.ndarray], residuals: Sequence[np.ndarray], *, local: bool = True
) -> np.ndarray:
    """Covariance of the values with the autocorrelation of the residuals (Bartlett's weights).

    As of one variance throughout, and where ``local`` as of residuals that are larger in places, as
    where a noisy alpha turns a large lift into drag (White; Newey and West): the larger of both.
    """
    gram = sum(part.T @ part for part in parts)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    n, count = sum(len(e) for e in residuals), len(gram)
    even, uneven = np.zeros((2, *inverse.shape))
    for lag in range(min(_LAGS, min(len(e) for e in residuals) - 1) + 1):
        weight = (0.5 if lag == 0 else 1.0 - lag / (_LAGS + 1.0)) * n / max(n - count, 1)
        together = [e[: len(e) - lag] * e[lag:] for e in residuals]
        pairs = [(X[: len(X) - lag] / scale, X[lag:] / scale) for X in parts]
        even += weight * sum(map(np.sum, together)) / n * sum(a.T @ b for a, b in pairs)
        uneven += weight * sum((a.T * w) @ b for (a, b), w in zip(pairs, together, strict=True))
    even, uneven = (inverse @ (each + each.T) @ inverse for each in (even, uneven))
    larger = np.maximum(local * np.diag(uneven) / np.maximum(np.diag(even), 1e-300), 1.0)
    return np.asarray(even * np.sqrt(np.outer(larger, larger)) / np.outer(scale, scale))
