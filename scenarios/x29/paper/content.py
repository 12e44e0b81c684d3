"""What the paper prints beside what was found here, as data for tables and for ``comparison.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scenarios.x29.measures import LARGE
from scenarios.x29.methods import MethodResult, between_grid_points
from scenarios.x29.paper.sentences import own_method
from scenarios.x29.published import (
    TURNED,
    has_table,
    printed_checks,
    printed_column,
    printed_correlation,
    printed_density,
    printed_noise,
    printed_start,
)
from scenarios.x29.study import LoopStudy

_BY_OUTPUT = {"alpha": "alpha", "q": "q", "nz": "nz_0"}  # in whose row R stands, as in the paper's tables by column


def paper_content(study: LoopStudy) -> dict[str, Any]:
    """Entries of ``comparison.json``: the paper's tables beside its procedure, its checks, the methods and the restarts."""
    column = study.scenario.published[0] if study.scenario.published else ""
    out: dict[str, Any] = {}
    if column:
        printed = printed_column(column)
        out["published"] = {
            "column": column,
            "values": {name: {"value": cell.value, **({} if cell.std is None else {"std": cell.std})} for name, cell in printed.items()},
            "turned": list(TURNED),
            "checks": {name: vars(told) for name, told in printed_checks(column).items()},
        }
    if study.scenario.methods and has_table(column):
        names, C = printed_correlation(column)
        out["published"]["states"] = {name: _known(row) for name, row in beside(study, column).items()}
        out["published"]["correlation"] = {"names": list(names), "matrix": C.tolist()}
        out["published"]["correlation_pairs"] = [
            {"pair": [a, b], "published": p, "paper_procedure": q, "refined": r} for a, b, p, q, r in noted_pairs(study, column)
        ]
        out["published"]["between_grid_points"] = between_grid_points(study.plain)
    if study.scenario.methods:
        units = dict(zip(study.plain.estimate.names, study.plain.estimate.units, strict=True))
        out["methods"] = [_method(m, units) for m in (*study.methods, own_method(study))]
    if study.restarts:
        out["plain_restarts"] = {
            label: {"delays": list(found.delays), "parameters": {name: value.tolist() for name, value in found.values.items()}}
            for label, found in study.restarts.items()
        }
    return out


def beside(study: LoopStudy, column: str) -> dict[str, dict[str, dict[str, float | None]]]:
    """By state and parameter: initial and final value and variance, R and Q of the paper's procedure here and as printed, SI."""
    system, bank = study.paper.system, study.plain.bank
    best = int(np.argmax(bank.log_likelihood))
    start, final, noise, density = printed_start(column), printed_column(column), printed_noise(column), printed_density(column)
    R = {_BY_OUTPUT[name]: (study.paper.noise_std[name] ** 2, std**2) for name, std in noise.items()}
    rows = {}
    for i, name in enumerate(bank.names):
        item = system.initial[name] if name in system.state_names else system.parameters[name]
        here = {
            "initial": item.value,
            "initial_variance": item.prior_std**2,
            "final": float(bank.mean[i, best]),
            "final_variance": float(bank.covariance[best, i, i]),
            "R": R[name][0] if name in R else None,
            "Q": float(study.scenario.estimation.process_noise.get(name, 0.0)),
        }
        known = name in start
        printed = {
            "initial": start[name].value if known else None,
            "initial_variance": _squared(start[name].std) if known else None,
            "final": final[name].value if known else None,
            "final_variance": _squared(final[name].std) if known else None,
            "R": R[name][1] if name in R else None,
            "Q": density.get(name, 0.0) if known else None,
        }
        rows[name] = {key: {"here": here[key], "published": printed[key]} for key in here}
    return rows


def noted_pairs(study: LoopStudy, column: str) -> list[tuple[str, str, float, float, float]]:
    """Pairs whose published correlation is above ``LARGE``: published, of the paper's procedure here, of the refined filter."""
    names, C = printed_correlation(column)
    bank, history = study.plain.bank, study.result.estimate.history
    assert history is not None
    plain = bank.covariance[int(np.argmax(bank.log_likelihood))]
    out = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            if abs(C[i, j]) > LARGE:
                out.append((b, a, float(C[i, j]), _correlation(plain, bank.names, a, b), _correlation(history.covariance[-1], history.names, a, b)))
    return out


def _correlation(P: np.ndarray, names: tuple[str, ...], a: str, b: str) -> float:
    i, j = names.index(a), names.index(b)
    return float(P[i, j] / np.sqrt(P[i, i] * P[j, j]))


def _known(row: dict[str, dict[str, float | None]]) -> dict[str, dict[str, float]]:
    """A row without what there is not."""
    kept = {key: {side: value for side, value in pair.items() if value is not None} for key, pair in row.items()}
    return {key: pair for key, pair in kept.items() if pair}


def _squared(std: float | None) -> float | None:
    return None if std is None else std**2


def _method(found: MethodResult, units: Mapping[str, str]) -> dict[str, Any]:
    return {
        "name": found.name,
        "label": found.label,
        "delay": found.delay,
        "log_likelihood": found.log_likelihood,
        "parameters": {name: {"estimate": value, "std": found.std[name], "unit": units.get(name, "s")} for name, value in found.values.items()},
        **({} if np.isnan(found.frequency) else {"natural_frequency": found.frequency, "damping_ratio": found.damping}),
    }
