"""The engine of a study's filters: one line for the terminal, and the key ``engine`` of its JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.banks.delays import ENGINES, SecondPass
from scenarios.studies.declaration import Estimation

UNSCENTED = "filterpy UnscentedKalmanFilter"


def engine_label(estimation: Estimation) -> str:
    """The engine of an estimation in words; empty where its method is no filter."""
    if estimation.method == "ukf":
        return UNSCENTED
    return ENGINES[estimation.engine].label if estimation.method == "ekf" else ""


def engine_line(estimations: Sequence[Estimation]) -> str:
    """``"engine: filterpy ExtendedKalmanFilter"``, with the methods of each engine where there are several; empty without a filter."""
    methods: dict[str, list[str]] = {}
    for each in estimations:
        if label := engine_label(each):
            methods.setdefault(label, []).append(each.name)
    if not methods:
        return ""
    several = len(methods) > 1
    return "engine: " + "; ".join(f"{label} ({', '.join(names)})" if several else label for label, names in methods.items())


def engine_content(estimation: Estimation) -> dict[str, Any]:
    """``{"engine": {...}}`` of an estimation; empty where its method is no filter."""
    label = engine_label(estimation)
    name = "filterpy" if estimation.method == "ukf" else estimation.engine
    return {"engine": {"name": name, "sentence": label}} if label else {}


def bank_line(name: str, second: SecondPass | None) -> str:
    """``engine_line`` of a bank of delays: the engine ``name``, and how far a second pass by filterpy is from its likeliest filter."""
    return f"engine: {bank_sentence(name, second)}"


def bank_sentence(name: str, second: SecondPass | None) -> str:
    """What stands behind ``engine:`` for a bank of delays."""
    label = ENGINES[name].label
    if second is None:
        return label if name == "filterpy" else f"{label}; no sound filter to compare with filterpy"
    return f"{label}; equals filterpy to {second.sigmas:.0e} sigma on the filter at {second.held:.4g} s"


def bank_content(name: str, second: SecondPass | None) -> dict[str, Any]:
    """Content of the key ``engine`` for a bank of delays; differences of means and standard deviations in sigmas."""
    content: dict[str, Any] = {"name": name, "sentence": bank_sentence(name, second)}
    if second is not None:
        content["against_filterpy"] = {
            "delay": second.held,
            "largest_sigmas": second.sigmas,
            "mean_sigmas": second.mean,
            "std_sigmas": second.std,
            "log_likelihood_share": second.log_likelihood,
        }
    return content
