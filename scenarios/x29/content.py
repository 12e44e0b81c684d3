"""The comparison file of a closed-loop study, with the paper's numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ident.banks.delays import DelayBank
from ident.estimate import Estimate
from ident.flying_qualities.levels import UNITS, QualityLevel
from scenarios.files.sources import versions
from scenarios.studies.comparison import SCHEMA, bank_content, choices_content
from scenarios.x29.declaration import (
    TURNED,
    LinearCheck,
    has_table,
    printed_checks,
    printed_column,
    printed_correlation,
    printed_density,
    printed_noise,
    printed_start,
)
from scenarios.x29.estimating import (
    LARGE_CORRELATION,
    LoopMethodResult,
    Misfit,
    OverSeeds,
    between_grid_points,
    start_of,
)
from scenarios.x29.findings import (
    bias_rows,
    not_identifiable,
    own_method,
    paper_sentences,
    sentences,
)
from scenarios.x29.open_margins import margins_content
from scenarios.x29.study import LoopResult, LoopStudy
from sim.closed_loop.linear import Margins
from sim.vehicles.factory import LOES_DERIVATIVES

# ---- Published values next to ours

# Output -> row of the paper's tables that has its R.
_BY_OUTPUT = {"alpha": "alpha", "q": "q", "nz": "nz_0"}


def units_of(study: LoopStudy) -> dict[str, str]:
    """Return the units of states and parameters, and of the frequency, damping ratio and delay."""
    estimate, system = study.result.estimate, study.result.setting.system
    units = {item.name: item.unit for item in (*system.initial, *system.parameters)}
    return units | dict(zip(estimate.names, estimate.units, strict=True)) | {"delay": "s"}


def paper_content(study: LoopStudy) -> dict[str, Any]:
    """Return entries of ``comparison.json`` on the paper: tables, procedure, checks, methods."""
    column = study.scenario.column
    out: dict[str, Any] = {}
    if column:
        printed = printed_column(column)
        out["published"] = {
            "column": column,
            "values": {
                name: {"value": cell.value, **({} if cell.std is None else {"std": cell.std})}
                for name, cell in printed.items()
            },
            "turned": list(TURNED),
            "checks": {
                name: vars(printed_value) for name, printed_value in printed_checks(column).items()
            },
        }
    if study.scenario.methods and has_table(column):
        names, C = printed_correlation(column)
        out["published"]["states"] = {
            name: _without_missing(row)
            for name, row in procedure_and_printed(study, column).items()
        }
        out["published"]["correlation"] = {"names": list(names), "matrix": C.tolist()}
        out["published"]["correlation_pairs"] = [
            {"pair": [a, b], "published": p, "paper_procedure": q, "refined": r}
            for a, b, p, q, r in correlated_pairs(study, column)
        ]
        out["published"]["between_grid_points"] = between_grid_points(study.single_pass)
    if study.scenario.methods:
        estimate = study.single_pass.estimate
        units = dict(zip(estimate.names, estimate.units, strict=True))
        out["methods"] = [_method(m, units) for m in (*study.methods, own_method(study))]
    if study.restarts:
        out["plain_restarts"] = {
            label: {
                "delays": list(result.delays),
                "parameters": {name: value.tolist() for name, value in result.values.items()},
            }
            for label, result in study.restarts.items()
        }
    return out


def procedure_and_printed(
    study: LoopStudy, column: str
) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return, by state and parameter, the numbers of Tables 1 and 2, here and as printed, SI.

    They are initial and final value and variance, R and Q of the paper's procedure.
    """
    system, bank = study.paper.system, study.single_pass.bank
    best = int(np.argmax(bank.log_likelihood))
    start, final = printed_start(column), printed_column(column)
    noise, density = printed_noise(column), printed_density(column)
    R = {
        _BY_OUTPUT[name]: (study.paper.noise_std[name] ** 2, std**2) for name, std in noise.items()
    }
    rows = {}
    for i, name in enumerate(bank.names):
        item = start_of(system, name)
        here = {
            "initial": item.value,
            "initial_variance": item.prior_std**2,
            "final": float(bank.mean[i, best]),
            "final_variance": float(bank.covariance[best, i, i]),
            "R": R[name][0] if name in R else None,
            "Q": float(study.scenario.estimation.process_noise.get(name, 0.0)),
        }
        printed: dict[str, float | None] = dict.fromkeys(here)
        printed["R"] = R[name][1] if name in R else None
        if name in start:
            printed |= {
                "initial": start[name].value,
                "initial_variance": _squared(start[name].std),
                "final": final[name].value,
                "final_variance": _squared(final[name].std),
                "Q": density.get(name, 0.0),
            }
        rows[name] = {key: {"here": here[key], "published": printed[key]} for key in here}
    return rows


def correlated_pairs(study: LoopStudy, column: str) -> list[tuple[str, str, float, float, float]]:
    """Return the pairs of parameters with a published correlation above ``LARGE_CORRELATION``.

    Each has three correlations: published, by the paper's procedure here, by the refined filter.
    """
    names, C = printed_correlation(column)
    bank, history = study.single_pass.bank, study.result.estimate.history
    assert history is not None
    covariance = bank.covariance[int(np.argmax(bank.log_likelihood))]
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    return [
        (
            names[j],
            names[i],
            float(C[i, j]),
            _correlation(covariance, bank.names, names[i], names[j]),
            _correlation(history.covariance[-1], history.names, names[i], names[j]),
        )
        for i, j in pairs
        if abs(C[i, j]) > LARGE_CORRELATION
    ]


def _correlation(P: np.ndarray, names: tuple[str, ...], a: str, b: str) -> float:
    i, j = names.index(a), names.index(b)
    return float(P[i, j] / np.sqrt(P[i, i] * P[j, j]))


def _without_missing(row: dict[str, dict[str, float | None]]) -> dict[str, dict[str, float]]:
    """Return the row without missing values."""
    pairs = {
        key: {side: value for side, value in pair.items() if value is not None}
        for key, pair in row.items()
    }
    return {key: pair for key, pair in pairs.items() if pair}


def _squared(std: float | None) -> float | None:
    return None if std is None else std**2


def _method(method: LoopMethodResult, units: Mapping[str, str]) -> dict[str, Any]:
    return {
        "name": method.name,
        "label": method.label,
        "delay": method.delay,
        "log_likelihood": method.log_likelihood,
        "parameters": {
            name: {"estimate": value, "std": method.std[name], "unit": units.get(name, "s")}
            for name, value in method.values.items()
        },
        **(
            {}
            if np.isnan(method.frequency)
            else {"natural_frequency": method.frequency, "damping_ratio": method.damping}
        ),
    }


# ---- The comparison file of a closed-loop scenario as strict JSON


def loop_comparison(study: LoopStudy) -> dict[str, Any]:
    """Return the content of ``comparison.json``.

    There are no true values, since the loop is of higher order than the model. ``loop_equivalent``
    is a low-order fit to the frequency response of the linear loop with the paper's L_q. Its
    differences from the fit with the flown L_q, beyond sigma, are the bias of the model.
    """
    result, scenario = study.result, study.scenario
    estimate, bank = result.estimate, result.bank
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": study.seed,
        "distance": scenario.distance,
        "own": choices_content(scenario.choices),
        "parameters": _parameters(study),
        "fixed": _fixed(result),
        "derived": {
            q.name: {"estimate": q.value, **({"std": q.std} if q.std > 0 else {}), "unit": q.unit}
            for q in result.qualities
        },
        "outcome": estimate.outcome.code,
        "outcome_sentence": estimate.outcome.value,
        "log_likelihood": estimate.log_likelihood,
        "noise_std": dict(result.setting.noise_std),
        "process_noise": dict(scenario.estimation.process_noise),
        "states": _states(study),
        "correlation": correlation_content(estimate),
        "bank": _bank(bank),
        "plain": {**_values(study.single_pass.estimate), "delay": study.single_pass.delay},
        "levels": [_level(level) for level in study.levels],
        "frequency_response": _check(study),
        "margins": {name: _margins(margins) for name, margins in study.margins.items()},
        "model_order_bias": [
            {
                "name": row.name,
                "estimate": row.estimate,
                "loop_equivalent": row.equivalent,
                "sigmas": row.sigmas,
            }
            for row in bias_rows(study)
        ],
        "not_identifiable": [
            {"name": a, "with": b, "correlation": r} for a, b, r in not_identifiable(estimate)
        ],
        "contradicted_priors": [
            {"name": name, "sigmas": sigmas} for name, sigmas in bank.contradicted
        ],
        "misfit": _misfit(study.misfit),
        "residual_tests": [
            {
                "name": t.name,
                "channel": t.channel,
                "statistic": t.statistic,
                "p_value": t.p_value,
                "passed": t.passed,
                "sentence": t.sentence,
            }
            for t in study.tests
        ],
        "iterations": estimate.iterations,
        "method": "bank of extended Kalman filters, refined",
        "findings": [*sentences(study), *([scenario.findings] if scenario.findings else [])],
        "published_findings": list(paper_sentences(study)),
        "versions": versions(),
    }
    if study.linear is not None:
        content["linear"] = linear_content(study.linear)
    if study.open_margins is not None:
        content["open_margins"] = margins_content(study.open_margins)
    return content | _against(study) | _further(study) | _engine(study) | paper_content(study)


def correlation_content(estimate: Estimate) -> dict[str, Any]:
    """Return the correlation matrix of states and parameters after the last sample, and the pairs
    above ``LARGE_CORRELATION``.
    """
    history = estimate.history
    assert history is not None
    P = history.covariance[-1]
    std = np.sqrt(np.maximum(np.diag(P), 1e-300))
    C = np.clip(P / np.outer(std, std), -1.0, 1.0)
    names = history.names
    large = [
        [names[i], names[j], float(C[i, j])]
        for i in range(len(names))
        for j in range(i)
        if abs(C[i, j]) > LARGE_CORRELATION
    ]
    return {"names": list(names), "matrix": C.tolist(), "large": large}


def _bank(bank: DelayBank) -> dict[str, Any]:
    return {
        "delays": bank.delays.tolist(),
        "log_likelihood": [float(v) for v in np.maximum(bank.log_likelihood, -1e300)],
        "weights": bank.weights.tolist(),
        "most_likely": bank.most_likely,
        "weighted_mean": bank.weighted_mean,
        "refined": bank.refined,
        **({"refined_std": bank.refined_std} if bank.refined_std > 0 else {}),
        "at_edge": bank.at_edge,
    }


def _margins(margins: Margins) -> dict[str, float]:
    return {
        "gain_decrease_db": max(margins.gain_decrease, -1e3),
        "gain_increase_db": min(margins.gain_increase, 1e3),
        "phase_deg": min(margins.phase, 1e3),
        "crossover_rad_s": margins.crossover,
    }


def _against(study: LoopStudy) -> dict[str, Any]:
    against = study.scenario.against
    if study.other is None or study.differences is None or against is None:
        return {}
    derived = dict(study.derived_differences)
    return {
        "against": {
            "scenario": against.scenario,
            "changes": list(against.changes),
            "seed": study.other.scenario.seed,
            "differences": [
                {
                    "name": d.name,
                    "unit": d.unit,
                    "other": d.first,
                    "other_std": d.first_std,
                    "z": d.z,
                    "beyond": d.beyond,
                }
                for d in study.differences.differences
            ],
            "p_value": study.differences.p_value,
            "derived": {
                item.name: {"other": item.value, "sigmas": derived.get(item.name, 0.0)}
                for item in study.other.qualities
            },
        }
    }


def _further(study: LoopStudy) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if study.together:
        out["together"] = {
            name: {**_values(result.estimate), "delay": result.delay}
            for name, result in study.together.items()
        }
    if len(study.passes) > 1:
        out["passes"] = [_values(estimate) for estimate in study.passes]
    if study.over_seeds is not None:
        out["over_seeds"] = _over_seeds(study.over_seeds)
    if study.variants:
        out["variants"] = [
            {
                "name": v.name,
                "label": v.label,
                "delay": v.delay,
                **_values(v.estimate),
                "misfit": _misfit(v.misfit),
            }
            for v in study.variants
        ]
    return out


def _over_seeds(statistics: OverSeeds) -> dict[str, Any]:
    """Return the counts of the chosen delays, and means and standard deviations of the parameters
    over the seeds.
    """

    def means(rows: np.ndarray) -> dict[str, Any]:
        spread = rows.std(axis=0, ddof=1) if len(rows) > 1 else np.zeros(rows.shape[1])
        return {
            name: {"mean": float(m), "std": float(s)}
            for name, m, s in zip(statistics.names, rows.mean(axis=0), spread, strict=True)
        }

    return {
        "seeds": list(statistics.seeds),
        "delays": statistics.delays.tolist(),
        "count": len(statistics.seeds),
        "parameters": means(statistics.values),
        "by_delay": [
            {"milliseconds": f"{1000.0 * delay:g}", "count": len(rows), "parameters": means(rows)}
            for delay, rows in statistics.by_delay()
        ],
    }


def _engine(study: LoopStudy) -> dict[str, Any]:
    """Return the engine of the bank, and how far it is from the other engine."""
    content, result = bank_content(study.scenario.estimation.engine, study.second), study.engines
    if result is None:
        return {"engine": content}
    differences = {
        "mean_sigmas": result.mean,
        "std_share": result.std,
        "log_likelihood_share": result.log_likelihood,
        "same_sound": result.sound,
    }
    return {"engine": {**content, "against_batched": differences}}


def _parameters(study: LoopStudy) -> dict[str, Any]:
    estimate = study.result.estimate
    printed = printed_column(study.scenario.column)
    rows = {}
    for name, unit, value, std in zip(
        estimate.names, estimate.units, estimate.values.tolist(), estimate.std.tolist(), strict=True
    ):
        row: dict[str, Any] = {"estimate": value, "std": std, "unit": unit}
        if name in LOES_DERIVATIVES:
            row["loop_equivalent"] = float(getattr(study.check.loop, name))
        if name in printed:
            row["published"] = {
                "value": printed[name].value,
                **({"std": s} if (s := printed[name].std) is not None else {}),
            }
        rows[name] = row
    return rows


def _fixed(result: LoopResult) -> dict[str, Any]:
    fixed = {
        p.name: {"value": p.value, "unit": p.unit}
        for p in result.setting.system.parameters
        if not p.free and p.name != "delay"
    }
    if "delay" not in result.estimate.names:
        fixed["delay"] = {"value": result.bank.refined, "unit": "s"}
    return fixed


def _states(study: LoopStudy) -> dict[str, Any]:
    """Return the numbers of Tables 1 and 2 by state and parameter of eq. 11.

    They are initial and final value and variance, R and Q.
    """
    history, system = study.result.estimate.history, study.result.setting.system
    assert history is not None
    noise, density = study.result.setting.noise_std, study.scenario.estimation.process_noise
    rows = {}
    for i, name in enumerate(history.names):
        item = start_of(system, name)
        rows[name] = {
            "initial": item.value,
            "initial_variance": item.prior_std**2,
            "final": float(history.mean[i, -1]),
            "final_variance": float(history.std[i, -1] ** 2),
            "process_noise": float(density.get(name, 0.0)),
            **({"measurement_variance": noise[name] ** 2} if name in noise else {}),
        }
    return rows


def _check(study: LoopStudy) -> dict[str, Any]:
    check, record = study.check, study.check.record
    names = (*LOES_DERIVATIVES, "natural_frequency", "damping_ratio")
    loops = {"loop": check.loop, "loop_with_flown_L_q": check.flown}
    out: dict[str, Any] = {
        key: {name: float(getattr(loop, name)) for name in names} for key, loop in loops.items()
    }
    out["mean_coherence"] = check.coherence
    if record is not None:
        out["record"] = {name: float(value) for name, value in record.items()}
    return out


def _values(estimate: Estimate) -> dict[str, Any]:
    return {
        "parameters": {
            n: {"estimate": float(v), "std": float(s)}
            for n, v, s in zip(estimate.names, estimate.values, estimate.std, strict=True)
        }
    }


def _level(level: QualityLevel) -> dict[str, Any]:
    c = level.criterion
    return {
        "quantity": c.quantity,
        "category": c.category,
        "value": level.quality.value,
        "std": level.quality.std,
        "unit": UNITS[c.quantity],
        "level": level.level,
        "best": level.best,
        "worst": level.worst,
        "source": c.source,
    }


def _misfit(misfit: Misfit) -> Mapping[str, Any]:
    return {
        "rms_over_noise": misfit.rms,
        "stretch": misfit.stretch,
        "elsewhere": misfit.elsewhere,
        "peak_measured": misfit.peak_measured,
        "peak_simulated": misfit.peak_simulated,
        "peak_percent": misfit.peak_percent,
        "q_innovations": {
            "lag_one": misfit.lag_one,
            "ljung_box": misfit.q_box,
            "share_below_fifth_of_nyquist": misfit.low_share,
        },
        "innovation_ratio": misfit.ratio,
    }


def linear_content(check: LinearCheck) -> dict[str, object]:
    """Return the check for ``comparison.json``, without sizes at which the aircraft departs."""
    curves = {
        label: [
            {"stick": size, "misfit": value}
            for size, value in zip(check.sticks, values, strict=True)
            if np.isfinite(value)
        ]
        for label, values in check.curves.items()
    }
    return {
        "misfit": dict(check.misfit),
        "q_misfit_of": dict(check.apart),
        "stick": check.stick,
        "by_stick": curves,
        "limited": check.limited,
    }
