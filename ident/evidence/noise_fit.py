"""Noise laws and sizes of force histories of largest evidence, with the exact gradient of the linear world."""

from __future__ import annotations

import math

import numpy as np

from ident.evidence.linear_world import Laws, LinearWorld
from ident.evidence.noise_law import NoiseLaw

_STEP = 1e-3  # of a logarithm, for the slope of a Gram matrix
_WIDEST = 12.0  # of a logarithm, from where the search begins
LOAD_WIDER = 5.0  # factor: one sigma of a force history's size about a tenth of its load


def noise_fitted(world: LinearWorld, laws: Laws, evaluations: int = 25) -> tuple[LinearWorld, Laws]:
    """The world with other sizes of its histories, and the laws: largest evidence times prior.

    The white level of each output stays; its discrepancy's size and time, and the histories' sizes are free.
    """
    from scipy.optimize import minimize

    present = [i for i in range(len(laws)) if any(valid[i].any() for valid in world.valid)]
    first = [math.log(max(laws[i].discrepancy, 1e-2 * laws[i].white)) for i in present]
    first += [math.log(laws[i].time) for i in present]
    loads = world.beside.sigma if world.beside is not None else ()
    first += [math.log(each) for each in loads]
    start = np.array(first)
    m = len(present)

    def laws_at(x: np.ndarray) -> list[NoiseLaw]:
        out = list(laws)
        for k, i in enumerate(present):
            out[i] = NoiseLaw(laws[i].white, math.exp(x[k]), math.exp(x[m + k]))
        return out

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        here, at = laws_at(x), world
        if world.beside is not None:
            at = world.like(world.beside.with_sigma(np.exp(x[2 * m :]).tolist()))
        parts = [at.grams(i, law) for i, law in enumerate(here)]
        try:
            found = at.solved(at.total(parts))
        except np.linalg.LinAlgError:
            return 1e12, np.zeros(len(x))
        value = found.evidence + at.log_prior(tuple(here))
        gradient = np.zeros(len(x))
        C, beta = found.covariance, found.offset
        for k, i in enumerate(present):
            for which in (0, 1):
                moved = here[i]
                size = math.exp(_STEP)
                moved = NoiseLaw(moved.white, moved.discrepancy * (size if which == 0 else 1.0), moved.time * (size if which else 1.0))
                slope = 0.0
                for place, (a, la, _), (b, lb, _) in zip(at.places, parts[i], at.grams_once(i, moved), strict=True):
                    d = (b - a) / _STEP
                    mine = beta[place]
                    slope -= 0.5 * (d[0, 0] + (lb - la) / _STEP - 2.0 * d[1:, 0] @ mine + mine @ d[1:, 1:] @ mine)
                    slope -= 0.5 * float(np.sum(C[np.ix_(place, place)] * d[1:, 1:]))
                prior = (moved.log_prior(at.interval, at.duration) - here[i].log_prior(at.interval, at.duration)) / _STEP
                gradient[k + which * m] = slope + prior
        if at.beside is not None:
            for number, place, block in at.history_blocks():
                inside = block @ beta[place]
                gradient[2 * m + number] += beta[place] @ inside + float(np.sum(C[np.ix_(place, place)] * block)) - len(place)
            away = (x[2 * m :] - np.log(world.typical)) / math.log(LOAD_WIDER)
            value -= 0.5 * float(away @ away)
            gradient[2 * m :] -= away / math.log(LOAD_WIDER)
        return -value, -gradient

    bounds = [(each - _WIDEST, each + _WIDEST) for each in start]
    options = {"maxfun": evaluations, "maxcor": 10, "ftol": 1e-7, "gtol": 0.05}
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    best = found.x
    if world.beside is not None:
        world = world.like(world.beside.with_sigma(np.exp(best[2 * m :]).tolist()))
    return world, tuple(laws_at(best))
