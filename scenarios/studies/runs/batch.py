"""Estimates of many records of one flight: filters as one batch, other methods one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import BankEstimate, run_bank
from ident.filters.ekf import SETTLED
from scenarios.studies.declaration import Estimation
from scenarios.studies.estimating import compiled, estimate_record, filter_settings
from sim.declaration.model import Model, System
from sim.record import Record

LANES = 8  # runs, of which a batch has a multiple: linear algebra adds up a single column in another order


@dataclass(frozen=True, eq=False)
class Estimates:
    """What k runs gave: parameters and sigmas ``(n, k)``, covariances ``(k, n, n)``, outcome codes, and of filters the sum of the normalised
    innovations squared ``(k,)`` and of how many measured numbers that is ``(k,)``, else zeros; ``noise_std (m, k)`` of ``outputs``, assumed or
    estimated."""

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    outcomes: tuple[str, ...]
    nis: np.ndarray
    degrees: np.ndarray
    outputs: tuple[str, ...]
    noise_std: np.ndarray


def is_batched(estimation: Estimation, feedback: bool) -> bool:
    """Whether runs go through one batch: a batch has one input, and under feedback no two runs have the same."""
    return estimation.method == "ekf" and not feedback


def one_by_one(estimation: Estimation, records: Sequence[Record], model: Model) -> Estimates:
    """Runs by a method that takes one record at a time."""
    own = replace(estimation, engine="batched")
    found = [estimate_record(own, record, model).estimate for record in records]
    histories = [each.history for each in found]
    return Estimates(
        found[0].names,
        np.array([each.values for each in found]).T,
        np.array([each.covariance for each in found]),
        tuple(each.outcome.code for each in found),
        np.array([0.0 if history is None else float(history.nis.sum()) for history in histories]),
        np.array([0 if history is None else int(history.degrees.sum()) for history in histories]),
        found[0].output_names,
        np.array([each.noise_std for each in found]).T,
    )


def batched(estimation: Estimation, records: Sequence[Record], model: Model) -> Estimates:
    """Filters of many runs as one batch, which is filled up so that no run's numbers depend on how many there are."""
    count = len(records)
    filled = [*records, *[records[0]] * (-count % LANES)]
    system, settings = compiled(estimation, model), filter_settings(estimation)
    z = np.stack([each.output_array(system.output_names)[0] for each in filled], axis=2)
    degrees = int(records[0].output_array(system.output_names)[1].sum())
    n_x = len(system.states)
    if math.isinf(estimation.spread):
        bank = run_bank(records[0], system, settings, z=z)
        mean, covariance, sound = bank.mean, bank.covariance, bank.sound
        nis = bank.nis.sum(axis=0)
    else:
        bank = run_bank(records[0], system, replace(settings, passes=1), z=z)
        mean, covariance, sound, nis = _narrowed_passes(estimation, records[0], system, bank, z)
    outcomes = tuple("converged" if each else "diverged" for each in sound[:count])
    told = np.array([[model.noise.measurement_std[name]] * count for name in system.output_names])
    found = bank.names[n_x:], mean[n_x:, :count], covariance[:count, n_x:, n_x:]
    return Estimates(*found, outcomes, nis[:count], np.full(count, degrees, dtype=int), system.output_names, told)


def _narrowed_passes(
    estimation: Estimation, record: Record, system: System, bank: BankEstimate, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means, covariances, soundness and NIS after further passes, each run started and narrowed by its own result, as `studies.estimating` does."""
    settings, n_x = replace(filter_settings(estimation), passes=1), len(system.states)
    declared = np.array([*(item.prior_std for item in system.initial), *(system.parameters[name].prior_std for name in bank.names[n_x:])])
    first = np.array(system.initial.values())
    mean, covariance, sound, nis = bank.mean.copy(), bank.covariance.copy(), bank.sound.copy(), bank.nis.sum(axis=0)
    active = np.flatnonzero(sound)
    for _ in range(1, estimation.passes):
        if active.size == 0:
            break
        taken = np.concatenate([active, np.full(-active.size % LANES, active[0])])
        std = np.sqrt(np.maximum(np.diagonal(covariance[taken], axis1=1, axis2=2).T[n_x:], 0.0))
        prior = np.repeat(declared[:, None], taken.size, axis=1)
        prior[n_x:] = np.minimum(prior[n_x:], estimation.spread * std)
        start = np.concatenate([np.repeat(first[:, None], taken.size, axis=1), mean[n_x:, taken]])
        again = run_bank(record, system, settings, z=z[:, :, taken], start=start, covariance=prior.T[:, :, None] ** 2 * np.eye(len(declared)))
        kept = slice(0, active.size)
        moved = np.max(np.abs(again.mean[n_x:] - mean[n_x:, taken]) / std, axis=0, initial=0.0)[kept]
        mean[:, active], covariance[active] = again.mean[:, kept], again.covariance[kept]
        sound[active], nis[active] = again.sound[kept], again.nis.sum(axis=0)[kept]
        active = active[again.sound[kept] & (moved >= SETTLED)]
    return mean, covariance, sound, nis
