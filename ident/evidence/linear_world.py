"""A set of effects linearised at its fit: log evidence, posterior and noise in closed form.

With residuals e, sensitivities A and a Gaussian prior the model is y = A beta + noise. Whitened by
the noise law of each output, everything follows from one Gram matrix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.evidence.histories import Histories
from ident.evidence.noise_law import NoiseLaw, whiten
from ident.evidence.priors import declared_sigma, half_normal_factor, prior_of
from ident.tracing.candidate_model.fitted_model import FittedModel
from sim.declaration.effect import full_name
from sim.declaration.proposal import SearchContext

Laws = tuple[NoiseLaw, ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """Posterior of all unknowns as offsets from the fit: ``offset (n,)``, ``precision (n, n)``."""

    evidence: float
    offset: np.ndarray
    precision: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance ``(n, n)`` of the posterior."""
        scale = 1.0 / np.sqrt(np.diag(self.precision))
        inside = self.precision * np.outer(scale, scale) + 1e-13 * np.eye(len(scale))
        return np.asarray(np.linalg.inv(inside) * np.outer(scale, scale))


@dataclass(eq=False)
class LinearWorld:
    """One fitted set of effects, linearised.

    ``knowledge`` : a Gaussian of the shared unknowns, precision and mean by full value, that takes the
    place of the declared priors (a record predicted after others); None where there is none.
    """

    fitted: FittedModel
    context: SearchContext
    beside: Histories | None = None
    knowledge: tuple[np.ndarray, np.ndarray] | None = None
    _grams: dict[tuple[int, NoiseLaw], list[tuple[np.ndarray, float, int]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        fit = self.fitted.fit
        layout = fit.layout
        own = len(fit.theta)
        self.times = [problem.record.time for problem in layout.problems]
        self.valid = [problem.valid for problem in layout.problems]
        self.interval = float(np.median(np.diff(self.times[0])))
        self.duration = max(float(time[-1] - time[0]) for time in self.times)
        columns = [fit.jacobians[r] for r in range(len(layout.problems))]
        places = [layout.columns(r) for r in range(len(layout.problems))]
        extra: list[np.ndarray] = []
        if self.beside is not None:
            for r, part in enumerate(self.beside.parts):
                width = part.shape[2]
                columns[r] = np.concatenate([columns[r], part], axis=2)
                places[r] = np.concatenate([places[r], np.arange(own, own + width)])
                extra.append(self.beside.precision[r])
                own += width
        self.places, self.size = places, own
        self.e = [np.where(v, x, 0.0) for v, x in zip(self.valid, fit.residuals, strict=True)]
        self.A = [np.where(v[:, :, None], x, 0.0) for v, x in zip(self.valid, columns, strict=True)]
        self._set_priors(extra)

    def _set_priors(self, extra: Sequence[np.ndarray]) -> None:
        fit = self.fitted.fit
        mean, precision, constant = np.zeros(self.size), np.zeros((self.size, self.size)), 0.0
        effects = {full_name(e, i.name): (e, i) for e in self.fitted.effects for i in e.parameters if i.free}
        self.one_sided: list[tuple[int, float, float]] = []
        shared = len(fit.layout.shared)
        for at, name in enumerate(fit.layout.names):
            plain, value = name.partition(", record")[0], float(fit.theta[at])
            if self.knowledge is not None and at < shared:
                continue
            if plain in effects:
                effect, item = effects[plain]
                known = prior_of(effect, item, value, self.context)
                if known is None:
                    continue
                centre, sigma = known.mean, known.sigma
                if known.one_sided:
                    side = 1.0 if item.bounds[0] == known.mean else -1.0
                    self.one_sided.append((at, side, known.mean - value))
            elif plain.startswith("bias_") or plain.endswith("(0)"):
                continue
            else:
                item = self.fitted.declared.parameters[plain]
                centre, sigma = item.value, declared_sigma(item.value)
            if np.isfinite(sigma):
                mean[at], precision[at, at] = centre - value, sigma**-2
                constant -= math.log(sigma)
        if self.knowledge is not None:
            known_precision, centre = self.knowledge
            precision[:shared, :shared] = known_precision
            mean[:shared] = centre - fit.theta[:shared]
            constant += 0.5 * float(np.linalg.slogdet(known_precision)[1])
        at = len(fit.theta)
        for block in extra:
            precision[at : at + len(block), at : at + len(block)] = block
            constant += 0.5 * float(np.linalg.slogdet(block)[1])
            at += len(block)
        self.mean, self.precision, self.constant = mean, precision, constant
        self.quadratic = float(mean @ precision @ mean)

    def like(self, beside: Histories) -> LinearWorld:
        """The same world with other sizes of its histories."""
        return LinearWorld(self.fitted, self.context, beside, self.knowledge, self._grams)

    # ------------------------------------------------------------------ closed form
    def grams(self, i: int, law: NoiseLaw) -> list[tuple[np.ndarray, float, int]]:
        """Of output ``i``, one a record: Gram matrix of [e, A] whitened, ln determinant, samples."""
        key = (i, law)
        if key not in self._grams:
            if len(self._grams) > 40:
                self._grams.clear()
            found = []
            for time, valid, e, A in zip(self.times, self.valid, self.e, self.A, strict=True):
                count = int(valid[i].sum())
                if not count:
                    found.append((np.zeros((A.shape[2] + 1,) * 2), 0.0, 0))
                    continue
                white, logs = whiten(law, time, valid[i], np.column_stack([e[i], A[i]]))
                found.append((white.T @ white, float(logs.sum()), count))
            self._grams[key] = found
        return self._grams[key]

    def grams_once(self, i: int, law: NoiseLaw) -> list[tuple[np.ndarray, float, int]]:
        """The same, not kept."""
        kept, self._grams = self._grams, {}
        try:
            return self.grams(i, law)
        finally:
            self._grams = kept

    @property
    def typical(self) -> np.ndarray:
        """Usual sizes of the histories."""
        assert self.beside is not None
        return np.array(self.beside.usual)

    def history_blocks(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Of each load and record: the load's number, the places of its unknowns, and their precision."""
        assert self.beside is not None
        out, at = [], len(self.fitted.fit.theta)
        for units in self.beside.units:
            for number, (block, sigma) in enumerate(zip(units, self.beside.sigma, strict=True)):
                out.append((number, np.arange(at, at + len(block)), block / sigma**2))
                at += len(block)
        return out

    def total(self, grams: Sequence[Sequence[tuple[np.ndarray, float, int]]]) -> tuple[np.ndarray, np.ndarray, float]:
        """Normal matrix ``(n, n)``, right-hand side ``(n,)`` and constant part of some outputs."""
        G, b, rest = np.zeros((self.size, self.size)), np.zeros(self.size), 0.0
        for output in grams:
            for place, (gram, logs, count) in zip(self.places, output, strict=True):
                G[np.ix_(place, place)] += gram[1:, 1:]
                b[place] += gram[1:, 0]
                rest += gram[0, 0] + logs + count * math.log(2.0 * math.pi)
        return G, b, rest

    def solved(self, parts: tuple[np.ndarray, np.ndarray, float]) -> Solution:
        """Log evidence and posterior from the parts of ``total``."""
        G, b, rest = parts
        precision, right = G + self.precision, b + self.precision @ self.mean
        scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
        inside = precision * np.outer(scale, scale) + 1e-12 * np.eye(self.size)
        root = np.linalg.cholesky(inside)
        half = np.linalg.solve(root, scale * right)
        offset = scale * np.linalg.solve(root.T, half)
        logdet = 2.0 * float(np.sum(np.log(np.diag(root))) - np.sum(np.log(scale)))
        quadratic = rest + self.quadratic - float(half @ half)
        evidence = -0.5 * quadratic + self.constant - 0.5 * logdet
        if self.one_sided:
            at = [place for place, _, _ in self.one_sided]
            unit = np.zeros((self.size, len(at)))
            unit[at, np.arange(len(at))] = 1.0
            rows = np.linalg.solve(root, scale[:, None] * unit)
            for column, (place, side, bound) in enumerate(self.one_sided):
                sigma = float(np.linalg.norm(rows[:, column]))
                evidence += half_normal_factor(side * (float(offset[place]) - bound), sigma)
        return Solution(float(evidence), offset, precision)

    def solution(self, laws: Laws) -> Solution:
        """Log evidence and posterior under noise laws, one an output."""
        return self.solved(self.total([self.grams(i, law) for i, law in enumerate(laws)]))

    def log_prior(self, laws: Laws) -> float:
        """Log prior density of the noise laws."""
        return sum(law.log_prior(self.interval, self.duration) for law in laws)

    def best_laws(self, laws: Laws, sweeps: int = 2, tries: int = 30) -> Laws:
        """Noise laws of largest evidence times prior, one output after the other."""
        from scipy.optimize import minimize

        current = list(laws)
        for _ in range(sweeps):
            before = list(current)
            for i, law in enumerate(before):
                if not any(valid[i].any() for valid in self.valid):
                    continue
                rest = self.total([self.grams(j, each) for j, each in enumerate(current) if j != i])
                first = np.log([law.white, max(law.discrepancy, 1e-3 * law.white), law.time])

                def cost(at: np.ndarray, i: int = i, rest: tuple = rest) -> float:
                    if np.any(np.abs(at) > 30.0):
                        return 1e12
                    trial = NoiseLaw(*np.exp(at).tolist())
                    mine = self.total([self.grams(i, trial)])
                    try:
                        found = self.solved((rest[0] + mine[0], rest[1] + mine[1], rest[2] + mine[2]))
                    except np.linalg.LinAlgError:
                        return 1e12
                    return -found.evidence - trial.log_prior(self.interval, self.duration)

                simplex = np.vstack([first, *(first + 0.4 * row for row in np.eye(3))])
                options = {"maxfev": tries, "initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05}
                found = minimize(cost, first, method="Nelder-Mead", options=options)
                current[i] = NoiseLaw(*np.exp(found.x).tolist())
            moved = [abs(math.log(a.white / b.white)) for a, b in zip(before, current, strict=True)]
            if max(moved) < 0.05:
                break
        return tuple(current)

    def misfit(self, laws: Laws, offset: np.ndarray) -> float:
        """Minus the log posterior density at an offset ``(n,)``, but for constants."""
        G, b, rest = self.total([self.grams(i, law) for i, law in enumerate(laws)])
        away = offset - self.mean
        return 0.5 * float(rest - 2.0 * b @ offset + offset @ G @ offset + away @ self.precision @ away)

    def log_densities(self, laws: Laws, offset: np.ndarray) -> list[np.ndarray]:
        """Log density of each sample given those before it, all outputs together: ``(N,)`` a record."""
        out = []
        each = zip(self.times, self.valid, self.e, self.A, self.places, strict=True)
        for time, valid, e, A, place in each:
            total = np.zeros(len(time))
            for i, law in enumerate(laws):
                left = (e[i] - A[i] @ offset[place])[:, None]
                white, logs = whiten(law, time, valid[i], left)
                total -= 0.5 * (white[:, 0] ** 2 + logs + math.log(2.0 * math.pi) * valid[i])
            out.append(total)
        return out
