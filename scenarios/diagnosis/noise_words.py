"""What is called noise in a diagnosis: the noise floor where the residual is white, else the
estimated sensor noise, with the residual apart.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.tracing.diagnosis import Diagnosis, Verdict

FLOOR, ESTIMATED, RESIDUAL = "noise floor", "sensor noise (estimated)", "residual"
EQUAL = 1e-9  # relative, to which a residual is its noise


def noise_headings(d: Diagnosis) -> tuple[str, ...]:
    """Headings of what stands beside an error: the noise, and the residual of the fit where that is
    another number in any channel.
    """
    return (RESIDUAL, ESTIMATED) if is_coloured(d) else (FLOOR,)


def noise_word(d: Diagnosis, channel: str) -> str:
    """What the noise of a channel is called."""
    return ESTIMATED if _apart(d, channel, residual_levels(d)) else FLOOR


def is_coloured(d: Diagnosis) -> bool:
    """Whether the residual of any channel is more than its noise."""
    left = residual_levels(d)
    return any(_apart(d, channel, left) for channel in d.noise_floor)


def residual_levels(d: Diagnosis) -> dict[str, float]:
    """Root mean square of what the fit leaves, by channel; of the declared model where no effect
    stands.
    """
    if d.verdict is Verdict.UNEXPLAINED:
        return {name: rms for name in d.noise_floor if (rms := _declared(d, name)) > 0.0}
    return {name: d.residual_std.get(name, floor) for name, floor in d.noise_floor.items()}


def _apart(d: Diagnosis, channel: str, left: Mapping[str, float]) -> bool:
    noise = d.noise_floor.get(channel)
    return noise is not None and channel in left and abs(left[channel] - noise) > EQUAL * noise


def _declared(d: Diagnosis, channel: str) -> float:
    parts = [
        item
        for item in d.fitted
        if channel in item.channels and channel in item.record.output_names
    ]
    rows = [
        (
            item.before[item.channels.index(channel)],
            item.used[item.channels.index(channel)] & item.record[channel].valid,
        )
        for item in parts
    ]
    values = np.concatenate([residual[used] for residual, used in rows]) if rows else np.zeros(0)
    return float(np.sqrt(np.mean(np.clip(values, -1e30, 1e30) ** 2))) if values.size else 0.0
