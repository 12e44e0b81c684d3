"""Turbulence as a history of gusts: triangular gusts in a row, with the prior of an exponential correlation."""

from __future__ import annotations

import numpy as np

from ident.evidence.linear_world import LinearWorld
from ident.tracing.screening.score_test import _motions, _signatures
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to

STEP = 0.2  # s, between gusts


def gust_columns(world: LinearWorld, gust: Traceable, context: SearchContext) -> tuple[tuple[np.ndarray, ...], float]:
    """Changes of the outputs by gusts of 1 m/s, one each ``STEP``, ``(m, N, k)`` a record; and the step."""
    shape = fitted_to(gust, context)
    onset = shape.traits.onset
    step = max(STEP, context.duration / 150.0)
    probe = Probe({"peak": 0.0, onset: context.begin, "duration": 2.0 * step}, ("peak",), shifts=True)
    parts = _signatures(world.fitted, _motions(world.fitted), shape, (probe,))[0]
    stride = max(1, round(step / context.interval))
    out = []
    for part in parts:
        count = part.shape[1]
        places = range(0, count - stride, stride)
        columns = np.zeros((part.shape[0], count, len(places)))
        for number, shift in enumerate(places):
            columns[:, shift:, number] = part[:, : count - shift, 0]
        out.append(columns)
    return tuple(out), stride * context.interval


def gust_precision(count: int, step: float, time: float, sigma: float) -> np.ndarray:
    """Precision ``(count, count)`` of a first-order process of standard deviation ``sigma``, values ``step`` s apart."""
    rho = np.exp(-step / time)
    out = np.diag(np.full(count, 1.0 + rho**2)) - rho * (np.eye(count, k=1) + np.eye(count, k=-1))
    out[0, 0] = out[-1, -1] = 1.0
    return np.asarray(out / (1.0 - rho**2) / sigma**2)
