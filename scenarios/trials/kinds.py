"""What an examination paper may hide, each kind with the name that answers it and how its parameters are drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Draw = Callable[[np.random.Generator, float, float], Mapping[str, float]]


@dataclass(frozen=True)
class Kind:
    """Something that may be hidden.

    ``term`` hides it and ``answer`` names it, empty where nothing in the library does. ``draw`` gives its parameters from a
    generator, the largest deflection (rad) and the record's length (s). ``apart`` draws anew for the second record; ``channels``
    it needs to be seen.
    """

    term: str
    answer: str
    draw: Draw
    apart: bool = False
    channels: tuple[str, ...] = ()


def _uniform(low: float, high: float, local: str) -> Draw:
    return lambda rng, peak, duration: {local: float(np.exp(rng.uniform(math.log(low), math.log(high))))}


def _share(low: float, high: float, local: str) -> Draw:
    return lambda rng, peak, duration: {local: float(peak * rng.uniform(low, high))}


def _signed(low: float, high: float, local: str) -> Draw:
    return lambda rng, peak, duration: {local: float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))}


def _jump(rng: np.random.Generator, peak: float, duration: float) -> Mapping[str, float]:
    chosen = str(rng.choice(["Cm_alpha", "Cm_q", "Cm_de"]))
    sizes = {"Cm_alpha": 0.35, "Cm_q": -7.0, "Cm_de": 0.4}
    values = dict.fromkeys(("Cm_alpha", "Cm_q", "Cm_de", "CL_alpha"), 0.0) | {chosen: sizes[chosen] * float(rng.uniform(0.6, 1.4))}
    return {"time": float(rng.uniform(0.25, 0.6) * duration), **values}


def _gust(rng: np.random.Generator, peak: float, duration: float) -> Mapping[str, float]:
    start, length = float(rng.uniform(0.1, 0.7) * duration), float(rng.uniform(0.5, 2.0))
    return {"peak": float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 5.0)), "start": start, "duration": length}


def _push(rng: np.random.Generator, peak: float, duration: float) -> Mapping[str, float]:
    start, length = float(rng.uniform(0.1, 0.7) * duration), float(rng.uniform(0.5, 3.0))
    moment = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.004, 0.012))
    return {"start": start, "duration": length, "moment": moment, "lift": float(rng.normal(0.0, 0.01))}


def _mode(rng: np.random.Generator, peak: float, duration: float) -> Mapping[str, float]:
    values = {"frequency": (9.0, 22.0), "damping": (0.015, 0.06), "lift": (0.05, 0.3), "moment": (-0.5, -0.1), "gyro": (0.01, 0.04)}
    return {name: float(rng.uniform(*span)) for name, span in values.items()} | {"angle_gain": 0.0}


KINDS: Mapping[str, Kind] = {
    "input-delay": Kind("input-delay", "input-delay", _uniform(0.02, 0.15, "delay")),
    "actuator-lag": Kind("actuator-lag", "actuator-lag", _uniform(0.04, 0.2, "time_constant")),
    "actuator-rate-limit": Kind("actuator-rate-limit", "actuator-rate-limit", _share(2.0, 5.0, "rate")),
    "actuator-saturation": Kind("actuator-saturation", "actuator-saturation", _share(0.5, 0.85, "limit")),
    "input-deadband": Kind("input-deadband", "input-deadband", _share(0.05, 0.25, "half_width")),
    "input-backlash": Kind("input-backlash", "input-backlash", _share(0.04, 0.2, "half_width")),
    "curved moment": Kind("own:tanh-moment", "moment-nonlinearity", lambda r, p, d: {"loss": float(r.uniform(-0.9, 0.9)), "width": 0.04}),
    "curved lift": Kind("own:stalling-lift", "lift-nonlinearity", _uniform(1.0, 4.0, "loss")),
    "weak control": Kind("own:weakening-control", "control-nonlinearity", lambda r, p, d: {"cubic": float(r.uniform(0.1, 0.35)) / p**2}),
    "derivative-jump": Kind("derivative-jump", "derivative-jump", _jump, apart=True),
    "elastic-mode": Kind("elastic-mode", "elastic-mode", _mode),
    "gust-turbulence": Kind("gust-turbulence", "gust-turbulence", _uniform(0.5, 2.5, "sigma")),
    "gust-discrete": Kind("gust-discrete", "gust-discrete", _gust, apart=True),
    "half-sine gust": Kind("own:half-sine-gust", "gust-discrete", _gust, apart=True),
    "speed-variation": Kind("speed-variation", "speed-variation", _signed(0.3, 1.2, "rate")),
    "unmeasured-input": Kind("unmeasured-input", "unmeasured-input", _push, apart=True),
    "vane-offset": Kind("vane-offset", "vane-offset", _uniform(2.0, 12.0, "arm"), channels=("nz",)),
    "sensor-scale:alpha": Kind("sensor-scale:alpha", "sensor-scale:alpha", _uniform(1.08, 1.3, "scale"), channels=("nz",)),
    "sensor-scale:q": Kind("sensor-scale:q", "sensor-scale:q", _uniform(1.08, 1.3, "scale"), channels=("nz",)),
    "sensor-lag:alpha": Kind("sensor-lag:alpha", "sensor-lag:alpha", _uniform(0.03, 0.15, "time_constant")),
    "sensor-delay:q": Kind("sensor-delay:q", "sensor-delay:q", _uniform(0.03, 0.12, "delay"), channels=("nz",)),
    "sensor-delay:nz": Kind("sensor-delay:nz", "sensor-delay:nz", _uniform(0.03, 0.12, "delay"), channels=("nz",)),
    "sensor-drift:q": Kind("sensor-drift:q", "sensor-drift:q", _signed(0.0003, 0.002, "slope"), apart=True),
    "sensor-drift:alpha": Kind("sensor-drift:alpha", "sensor-drift:alpha", _signed(0.0003, 0.002, "slope"), apart=True),
    "sensor-spikes:q": Kind("sensor-spikes:q", "sensor-spikes:q", _uniform(0.03, 0.1, "size")),
    "product": Kind("own:alpha-control-product", "", _signed(4.0, 9.0, "moment")),
    "periodic": Kind("own:periodic-moment", "", lambda r, p, d: {"size": float(r.uniform(0.002, 0.006)), "frequency": float(r.uniform(3.0, 8.0))}),
}
