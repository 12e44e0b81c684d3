"""Force histories: what acts on the vehicle and is in no model, as unknowns with a Gaussian prior.

Each load that the equations can take (lift, moment, side force, ...) has a history of pulses in a row
whose sizes are a first-order process. The discrepancy of `noise_law` stands at the sensors; this one
acts through the dynamics, so that a model error of the forces is not taken for a sensor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.screening.score_test import _motions, _signatures
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to

MOST_NODES = 40  # of one history in one record
SHORTEST = 0.4  # s, of a pulse
CORRELATION = 1.0  # s, of the sizes of the pulses


@dataclass(frozen=True, eq=False)
class Histories:
    """Histories of several loads.

    Attributes
    ----------
    parts : ``(m, N, k)`` a record, changes of the outputs by pulses of unit size.
    units : ``(k, k)`` a record and load, precision of a history of standard deviation one.
    sigma : standard deviation of each load's history. usual : what it is before any record is seen.
    """

    parts: tuple[np.ndarray, ...]
    units: tuple[tuple[np.ndarray, ...], ...]
    sigma: tuple[float, ...]
    usual: tuple[float, ...] = ()

    @property
    def precision(self) -> tuple[np.ndarray, ...]:
        """Precision ``(k, k)`` of all histories of each record."""
        out = []
        for blocks in self.units:
            whole = np.zeros((sum(len(block) for block in blocks),) * 2)
            at = 0
            for block, sigma in zip(blocks, self.sigma, strict=True):
                whole[at : at + len(block), at : at + len(block)] = block / sigma**2
                at += len(block)
            out.append(whole)
        return tuple(out)

    def with_sigma(self, sigma: Sequence[float]) -> Histories:
        """The same histories with other standard deviations."""
        return replace(self, sigma=tuple(sigma))


def first_order_precision(count: int, step: float, time: float) -> np.ndarray:
    """Precision ``(count, count)`` of a first-order process of standard deviation one."""
    rho = np.exp(-step / time)
    out = np.diag(np.full(count, 1.0 + rho**2)) - rho * (np.eye(count, k=1) + np.eye(count, k=-1))
    out[0, 0] = out[-1, -1] = 1.0
    return np.asarray(out / (1.0 - rho**2))


def force_histories(fitted: FittedModel, candidates: Sequence[Traceable], context: SearchContext, share: float = 0.1) -> Histories | None:
    """Histories of the loads of all unmeasured inputs; None where the equations take none.

    ``share`` : standard deviation to begin with, of the declared size of each load.
    """
    loads = [each for each in candidates if each.name.startswith("unmeasured-input") and any(item.name == "duration" for item in each.parameters)]
    if not loads:
        return None
    step = max(SHORTEST, context.duration / MOST_NODES)
    stride = max(1, round(step / context.interval))
    motions = _motions(fitted)
    by_load, sigma = [], []
    for load in loads:
        shape = fitted_to(load, context)
        values = {item.name: shape.absent.get(item.name, item.value) for item in shape.parameters}
        values |= {shape.traits.onset: context.begin, "duration": stride * context.interval}
        sizes = [item for item in shape.parameters if item.name in shape.absent]
        probes = [Probe(values, (item.name,), shifts=True) for item in sizes]
        for item, parts in zip(sizes, _signatures(fitted, motions, shape, probes), strict=True):
            by_load.append([_moved(part[:, :, 0], stride) for part in parts])
            sigma.append(share * abs(item.value - shape.absent[item.name]))
    records = range(len(by_load[0]))
    parts = tuple(np.concatenate([load[r] for load in by_load], axis=2) for r in records)
    units = tuple(tuple(first_order_precision(load[r].shape[2], stride * context.interval, CORRELATION) for load in by_load) for r in records)
    return Histories(parts, units, tuple(sigma), tuple(sigma))


def _moved(part: np.ndarray, stride: int) -> np.ndarray:
    """One pulse's change of the outputs ``(m, N)``, begun every ``stride`` samples: ``(m, N, k)``."""
    count = part.shape[1]
    places = range(0, count - stride, stride)
    out = np.zeros((*part.shape, len(places)))
    for number, shift in enumerate(places):
        out[:, shift:, number] = part[:, : count - shift]
    return out
