"""From true signals on a fine grid to a folder: filters, sampling, noise, quantisation, CSV files,
vehicle file and truth.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, lfilter_zi

Signals = dict[str, np.ndarray]
UNITS: Mapping[str, str] = {
    **dict.fromkeys(("alpha", "beta", "theta", "phi", "elevator", "aileron", "rudder"), "rad"),
    **dict.fromkeys(("p", "q", "r"), "rad/s"),
    **dict.fromkeys(("nx", "ny", "nz"), "g"),
    **{"airspeed": "m/s", "thrust": "N"},
}
SIGMA: Mapping[str, float] = {
    **dict.fromkeys(("alpha", "beta", "theta", "phi"), float(np.radians(0.1))),
    **dict.fromkeys(("p", "q", "r"), float(np.radians(0.1))),
    **{"nx": 0.004, "ny": 0.006, "nz": 0.01, "airspeed": 0.25},
}
"""Standard deviations of the sensors' noise, before filters, in SI units and g."""
BEFORE_FILTER = 0.5  # share of the noise power that passes the anti-alias filter
STEPS_PER_SIGMA = 4.0  # quantisation steps in a standard deviation of the noise


@dataclass(frozen=True)
class Recorder:
    """Settings of the recording: samples per second, cut-off of the filter of all channels (Hz, or
    None), noise relative to `SIGMA`.
    """

    rate: float
    cutoff: float | None
    noise: float = 1.0


@dataclass(frozen=True)
class Planted:
    """One hidden cause, as the truth file has it.

    Parameters
    ----------
    kind : the cause in words.
    right : effect names that are right; empty if the library has no effect for it.
    near : names that fit the record nearly as well. A claim of one is right if a name of ``right``
        is among its alternatives; for a cause outside the library it is not wrong.
    words : columns or words by which a warning identifies the cause.
    values : true values by effect name and parameter, SI.
    """

    kind: str
    right: tuple[str, ...] = ()
    near: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def filtered(values: np.ndarray, step: float, cutoff: float | None) -> np.ndarray:
    """Return the signal behind a second-order Butterworth low-pass at ``cutoff`` Hz, at rest at the
    first value.
    """
    if cutoff is None:
        return values
    b, a = butter(2, cutoff * 2.0 * step)
    shown, _ = lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])
    return np.asarray(shown)


def recorded(
    signals: Signals, step: float, inputs: Sequence[str], how: Recorder, rng: np.random.Generator
) -> tuple[np.ndarray, Signals, dict[str, float]]:
    """Return sample times, columns, and for each output the standard deviation of noise and
    quantisation.

    Inputs have the same filter as outputs and no noise.
    """
    stride = round(1.0 / (how.rate * step))
    if abs(stride * how.rate * step - 1.0) > 1e-9:
        raise ValueError(f"{how.rate} Hz does not divide the fine rate {1.0 / step:g} Hz")
    columns: Signals = {}
    sigmas: dict[str, float] = {}
    for name, values in signals.items():
        clean = filtered(values, step, how.cutoff)[::stride]
        if name in inputs:
            columns[name] = clean
            continue
        sigma = how.noise * SIGMA[name]
        if how.cutoff is None:
            noise = sigma * rng.standard_normal(len(clean))
        else:
            # White at the recorder's sample rate, so that its level does not depend on the fine
            # grid.
            early = np.repeat(rng.standard_normal(len(clean)), stride)[: len(values)]
            early = filtered(early, step, how.cutoff)[::stride] * np.sqrt(BEFORE_FILTER)
            late = rng.standard_normal(len(clean)) * np.sqrt(1.0 - BEFORE_FILTER)
            noise = sigma * (early + late)
        bit = sigma / STEPS_PER_SIGMA
        columns[name] = np.round((clean + noise) / bit) * bit
        sigmas[name] = float(np.std(columns[name] - clean))
    return step * stride * np.arange(len(next(iter(columns.values())))), columns, sigmas


def write_record(path: Path, time: np.ndarray, columns: Signals) -> None:
    """Write a CSV file with units in its header."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", *(f"{name} [{UNITS[name]}]" for name in columns)])
        for k, at in enumerate(time):
            writer.writerow([f"{at:.6g}", *(f"{values[k]:.9g}" for values in columns.values())])


def wrong_starts(derivatives: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Draw derivatives with an error of 10 to 30 % of either sign."""
    share = rng.uniform(0.1, 0.3, len(derivatives)) * rng.choice([-1.0, 1.0], len(derivatives))
    return {
        name: value * (1.0 + float(error))
        for (name, value), error in zip(derivatives.items(), share, strict=True)
    }


def write_folder(
    folder: Path,
    records: Sequence[tuple[np.ndarray, Signals, dict[str, float]]],
    vehicle: Mapping[str, Any],
    starts: Mapping[str, float],
    truth: Mapping[str, Any],
) -> None:
    """Write ``train-1.csv`` and so on, the last record as ``validate.csv``, ``vehicle.toml``, and
    ``truth.json`` for the examiner alone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("train-*.csv"):
        old.unlink()
    for number, (time, columns, _) in enumerate(records, start=1):
        last = number == len(records)
        write_record(folder / ("validate.csv" if last else f"train-{number}.csv"), time, columns)
    lines = [
        f"{name} = {json.dumps(value) if isinstance(value, str) else format(value, '.8g')}"
        for name, value in vehicle.items()
    ]
    lines += ["", "[derivatives]", *(f"{name} = {value:.5g}" for name, value in starts.items()), ""]
    (folder / "vehicle.toml").write_text("\n".join(lines), encoding="utf-8", newline="\n")
    whole = {**truth, "sigma": records[-1][2]}
    text = json.dumps(whole, indent=1) + "\n"
    (folder / "truth.json").write_text(text, encoding="utf-8", newline="\n")


def truth_of(
    model: str,
    aircraft: str,
    causes: Sequence[Planted],
    harmless: Sequence[str],
    derivatives: Mapping[str, float],
    notes: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the content of ``truth.json`` without the noise."""
    return {
        "model": model,
        "aircraft": aircraft,
        "hidden": [cause.kind for cause in causes],
        "accepted": [
            {"right": list(cause.right), "near": list(cause.near), "words": list(cause.words)}
            for cause in causes
        ],
        "harmless": sorted(harmless),
        "values": {name: dict(values) for cause in causes for name, values in cause.values.items()},
        "derivatives": dict(derivatives),
        **notes,
    }
