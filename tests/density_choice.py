"""How much process noise a filter needs: the least that the likelihood of a record asks for.

NASA TM-101722 turned the weights by hand on the simulation's record until overplots and innovations
looked good, kept them low, and reused them on flight. The rule here: for each density of a coarse
logarithmic grid run the bank of delays; among the densities whose best filter lies within three
units of the largest log-likelihood (a factor of twenty) take the smallest. The innovations'
likelihood is largest where they are white and as large as the filter expects, so no test enters
twice; ``innovation_ratio`` and the residual tests tell how far it got.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.banks.bank import run_bank
from ident.filters.ekf import FilterSettings
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

DENSITIES = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
# s, finer than the bank's: a wrong delay would pass for process noise
DELAYS = tuple(0.0125 * i for i in range(17))
WITHIN = 3.0


@dataclass(frozen=True, eq=False)
class DensityChoice:
    """The densities tried ``(D,)``, log-likelihood of the best filter of each, how large its
    innovations are over what it expects (root of the mean normalised square, 1 is right), its delay
    (s), and the density chosen."""

    densities: np.ndarray
    log_likelihood: np.ndarray
    innovation_ratio: np.ndarray
    delays: np.ndarray
    chosen: float


def choose_density(
    record: Record,
    system_with: Callable[[float], System],
    densities: Sequence[float] = DENSITIES,
    settings: FilterSettings | None = None,
    *,
    delays: Sequence[float] = DELAYS,
    name: str = "delay",
) -> DensityChoice:
    """Choose a spectral density by the rule above.

    Parameters
    ----------
    system_with : the filter's System for a density, e.g. of q's rate, rad2/s3.
    densities : increasing, zero allowed.
    delays, name : the bank's, s; ``name`` is a held parameter.

    Raises
    ------
    ModelError : no density gave a sound filter; else as for ``run_bank``.
    """
    best, ratio, at = (
        np.full(len(densities), -np.inf),
        np.zeros(len(densities)),
        np.zeros(len(densities)),
    )
    for i, density in enumerate(densities):
        bank = run_bank(
            record,
            system_with(density),
            settings,
            fixed_values={name: np.asarray(delays, dtype=float)},
        )
        top = int(np.argmax(bank.log_likelihood))
        if not np.isfinite(bank.log_likelihood[top]):
            continue
        _, valid = record.output_array(system_with(density).output_names)
        best[i], at[i], ratio[i] = (
            bank.log_likelihood[top],
            delays[top],
            np.sqrt(bank.nis[:, top].sum() / np.count_nonzero(valid)),
        )
    if not np.any(np.isfinite(best)):
        raise ModelError(
            "every filter broke down",
            where=f"process noise on {record.name}",
            remedy="check units and starting values",
        )
    chosen = float(densities[int(np.argmax(best >= best.max() - WITHIN))])
    return DensityChoice(np.asarray(densities, dtype=float), best, ratio, at, chosen)
