"""What runs leave at the reference values: a misfit that is the same in all of them, and colour of what is random.

Residuals are those of the method's model with its parameters held at the reference and integrated finely, so that neither a start nor a step has a
part in them. By S, the slopes of the outputs in units of the noise, a misfit d moves estimates by P S' d with the stated covariance P; noise of the
autocovariance R makes them scatter by P S' R S P.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import filter_batched, run_bank
from ident.filters.ekf import FilterSettings, run_ekf
from ident.statistics.residual_spectrum import autocovariance
from scenarios.studies.estimating import compiled
from scenarios.studies.runs.batch import is_batched
from scenarios.studies.runs.work import EstimatorRuns
from sim.errors import FlightidError

RUNS, ALONE = 32, 6  # from which residuals are taken
HELD = 1e-6  # of a parameter's prior deviation: how far it may go from the reference
FINE = 4  # steps of a sample


@dataclass(frozen=True, eq=False)
class Residuals:
    """``misfit`` : root mean square of what all runs have in common, in units of the noise. ``colour`` ``(m,)`` : correlation of neighbouring
    samples of the rest by output, ``outputs`` their names; ``colour_std`` its deviation for white noise. ``lags`` ``(m, L)`` : autocovariance of the
    rest; ``valid``, ``common`` ``(m, N)`` : what was measured, and the mean of all runs."""

    misfit: float
    colour: np.ndarray
    colour_std: float
    outputs: tuple[str, ...]
    lags: np.ndarray
    valid: np.ndarray
    common: np.ndarray

    @property
    def coloured(self) -> bool:
        """Whether some output's noise is not white."""
        return bool(np.any(np.abs(self.colour) > max(5.0 * self.colour_std, 0.05)))


def residuals_of(work: EstimatorRuns, seeds: Sequence[int]) -> Residuals | None:
    """From the first runs; None where the model held at the reference leaves all measure."""
    estimation, reference = work.estimation, work.common.reference
    model = work.common.model.with_values({name: reference[name] for name in work.parameters})
    held = {name: HELD * max(abs(reference[name]), 1e-3) for name in work.parameters}
    model = replace(model, parameters=model.parameters.with_prior(held)).with_noise(replace(model.noise, process_density={}))
    filtered = replace(estimation, method="ekf", process_noise={}, passes=1)
    system = compiled(filtered, model)
    settings = FilterSettings(max_step=1.0 / (FINE * work.seen.flight.rate))
    many = is_batched(filtered, bool(work.seen.flight.feedback))
    records = [work.record_of(seed) for seed in seeds[: RUNS if many else ALONE]]
    try:
        if many:
            z = np.stack([record.output_array(system.output_names)[0] for record in records], axis=2)
            bank = run_bank(records[0], system, settings, z=z, keep=True)
            assert bank.innovation is not None and bank.innovation_std is not None
            normal = bank.innovation / bank.innovation_std
            sound = bool(np.all(bank.sound))
        else:
            histories = [run_ekf(record, system, settings, by=filter_batched).history for record in records]
            normal = np.stack([h.innovation / h.innovation_std for h in histories if h is not None], axis=2)
            sound = normal.shape[2] == len(records)
    except FlightidError:
        return None
    valid = records[0].output_array(system.output_names)[1]
    return split(normal, valid, system.output_names) if sound and np.all(np.isfinite(normal)) else None


def split(normal: np.ndarray, valid: np.ndarray, outputs: Sequence[str]) -> Residuals:
    """Normalised residuals ``(m, N, K)`` of K runs as a common misfit and its rest."""
    runs = normal.shape[2]
    common = normal.mean(axis=2, keepdims=True)
    rest = np.where(valid[:, :, None], normal - common, 0.0) * (runs / (runs - 1.0)) ** 0.5
    variance = np.sum(rest**2, axis=(1, 2)) / np.maximum(runs * valid.sum(axis=1), 1)
    excess = np.where(valid, common[:, :, 0] ** 2 - variance[:, None] / runs, 0.0).sum() / max(valid.sum(), 1)
    # What chance leaves in so few runs is no misfit.
    excess *= excess > 4.0 * float(variance.mean()) * np.sqrt(2.0 / max(valid.sum(), 1)) / runs
    count = max(10, normal.shape[1] // 5)
    lags = np.array([np.mean([autocovariance(rest[i, :, run], count) for run in range(runs)], axis=0) for i in range(len(rest))])
    lags *= normal.shape[1] / np.maximum(valid.sum(axis=1), 1)[:, None]
    colour = lags[:, 1] / np.maximum(lags[:, 0], 1e-300)
    return Residuals(
        float(np.sqrt(max(excess, 0.0))), colour, 1.0 / float(np.sqrt(runs * valid.sum(axis=1).min())), tuple(outputs), lags, valid, common[:, :, 0]
    )
