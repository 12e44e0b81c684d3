"""What the library has a name for, hidden in the fall of a body."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exam.random_cases.case import Kind, Setting
from exam.random_cases.sizes import either, several, signed, uniform

BALLISTIC = ("ballistic",)


def _mach_drag(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    # Only near the speed of sound does drag change within less than a Mach number, and no fall
    # drawn here comes that low.
    return {
        "size": either(rng) * float(rng.uniform(0.2, 0.5)),
        **several(rng, middle=(3.0, 4.5), width=(1.0, 2.0)),
    }


def _drag_jump(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "time": float(rng.uniform(0.5, 0.8) * s.duration),
        "factor": float(np.exp(either(rng) * rng.uniform(0.2, 0.6))),
    }


def _zero_step(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "at": float(rng.uniform(0.2, 0.8) * s.duration),
        "size": either(rng) * float(rng.uniform(40.0, 120.0)),
    }


FALLING: Mapping[str, Kind] = {
    "density-scale-height": Kind(
        signed(0.04, 0.12, "change"), "density-scale-height", "density-scale-height", BALLISTIC
    ),
    "mach drag": Kind(_mach_drag, "own:mach-drag", "drag-mach", BALLISTIC),
    "drag-jump": Kind(_drag_jump, "drag-jump", "drag-jump", BALLISTIC, apart=True),
    "sensor-scale:altitude": Kind(
        uniform(1.04, 1.15, "scale"), "sensor-scale:altitude", "sensor-scale:altitude", BALLISTIC
    ),
    "sensor-drift:altitude": Kind(
        signed(10.0, 30.0, "slope"),
        "sensor-drift:altitude",
        "sensor-drift:altitude",
        BALLISTIC,
        apart=True,
    ),
    "sensor-step:altitude": Kind(
        _zero_step, "sensor-step:altitude", "sensor-step:altitude", BALLISTIC, apart=True
    ),
    "sensor-spikes:altitude": Kind(
        uniform(80.0, 400.0, "size"), "sensor-spikes:altitude", "sensor-spikes:altitude", BALLISTIC
    ),
}
