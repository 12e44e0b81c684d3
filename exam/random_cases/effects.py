"""What the library has a name for, hidden in an aircraft: library effects and other forms of
them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exam.random_cases.case import Kind, Setting
from exam.random_cases.sizes import either, pulse, several, share, signed, uniform

RIGID, NZ = ("rigid",), ("nz",)


def _curved_moment(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"loss": s.moment * either(rng) * float(rng.uniform(0.2, 0.9)), "width": 0.04}


def _curved_lift(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"loss": s.lift * float(rng.uniform(1.0, 4.0))}


def _weak_control(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"cubic": float(rng.uniform(0.1, 0.35)) / s.peak**2}


def _jump(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    names = (
        ("Cm_alpha", "Cm_q", "Cm_de", "CL_alpha")
        if "Cm_alpha" in s.model.parameters
        else ("M_alpha", "M_q", "M_delta", "L_alpha")
    )
    chosen, part = int(rng.choice(3)), float(rng.uniform(0.6, 1.4))
    # Shares of usual derivatives: stability and control are lost, damping is gained.
    size = (-0.37, 0.41, -0.31)[chosen] * s.value(names[chosen])
    return {
        "time": float(rng.uniform(0.25, 0.6) * s.duration),
        **dict.fromkeys(names, 0.0),
        names[chosen]: part * size,
    }


def _mode(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    values = several(
        rng,
        frequency=(9.0, 22.0),
        damping=(0.015, 0.06),
        lift=(0.05, 0.3),
        moment=(-0.5, -0.1),
        gyro=(0.01, 0.04),
    )
    # The low-order equivalent counts nose up as positive, a trailing edge down turns the nose down.
    turned = 1.0 if s.control == 1.0 else -1.0
    loads = {
        "lift": values["lift"] * turned * s.lift / s.control,
        "moment": values["moment"] * turned * s.moment / s.control,
    }
    return {**values, **loads, "gyro": values["gyro"] * turned / s.control, "angle_gain": 0.0}


def _gust(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    start, length = pulse(rng, s, 0.5, 2.0)
    return {"peak": either(rng) * float(rng.uniform(2.0, 5.0)), "start": start, "duration": length}


def _push(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    start, length = pulse(rng, s, 0.5, 3.0)
    moment = s.moment * either(rng) * float(rng.uniform(0.004, 0.012))
    return {
        "start": start,
        "duration": length,
        "moment": moment,
        "lift": s.lift * float(rng.normal(0.0, 0.01)),
    }


def _exchange(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "gravity": 1.0,
        **several(rng, path=(-0.09, 0.09), weight_share=(0.05, 0.12), induced=(0.2, 0.6)),
    }


def _zero_step(channel: str) -> Kind:
    sigma = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012}[channel]

    def draw(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
        return {
            "at": float(rng.uniform(0.2, 0.7) * s.duration),
            "size": sigma * either(rng) * float(rng.uniform(4.0, 12.0)),
        }

    name = f"sensor-step:{channel}"
    return Kind(draw, name, name, apart=True)


def _same_name(name: str, draw: object, **more: object) -> Kind:
    return Kind(draw, name, name, **more)  # type: ignore[arg-type]


EFFECTS: Mapping[str, Kind] = {
    "input-delay": _same_name("input-delay", uniform(0.02, 0.15, "delay"), models=RIGID),
    "actuator-lag": _same_name("actuator-lag", uniform(0.04, 0.2, "time_constant"), models=RIGID),
    "actuator-rate-limit": _same_name("actuator-rate-limit", share(2.0, 5.0, "rate")),
    "actuator-saturation": _same_name("actuator-saturation", share(0.5, 0.85, "limit")),
    "input-deadband": _same_name("input-deadband", share(0.05, 0.25, "half_width")),
    "input-backlash": _same_name("input-backlash", share(0.04, 0.2, "half_width")),
    "curved moment": Kind(_curved_moment, "own:tanh-moment", "moment-nonlinearity"),
    "curved lift": Kind(_curved_lift, "own:stalling-lift", "lift-nonlinearity"),
    "weak control": Kind(_weak_control, "own:weakening-control", "control-nonlinearity"),
    "derivative-jump": _same_name("derivative-jump", _jump, apart=True),
    "elastic-mode": _same_name("elastic-mode", _mode),
    "gust-turbulence": _same_name("gust-turbulence", uniform(0.5, 2.5, "sigma")),
    "gust-discrete": _same_name("gust-discrete", _gust, apart=True),
    "half-sine gust": Kind(_gust, "own:half-sine-gust", "gust-discrete", apart=True),
    "speed-variation": _same_name("speed-variation", signed(0.3, 1.2, "rate")),
    "energy exchange": Kind(
        _exchange,
        "own:energy-exchange",
        "phugoid",
        models=RIGID,
        apart=True,
        same=("weight_share", "induced"),
    ),
    "unmeasured-input": _same_name("unmeasured-input", _push, apart=True),
    "vane-offset": _same_name("vane-offset", uniform(2.0, 12.0, "arm"), channels=NZ),
    "accelerometer-offset:nz": _same_name(
        "accelerometer-offset:nz", uniform(3.0, 12.0, "arm"), channels=NZ
    ),
    "quadratic vane": Kind(
        signed(2.0, 6.0, "curvature"), "sensor-curve:alpha", "sensor-curve:alpha", channels=NZ
    ),
    "sensor-scale:alpha": _same_name(
        "sensor-scale:alpha", uniform(1.08, 1.3, "scale"), channels=NZ
    ),
    "sensor-scale:q": _same_name("sensor-scale:q", uniform(1.08, 1.3, "scale"), channels=NZ),
    "sensor-lag:alpha": _same_name("sensor-lag:alpha", uniform(0.03, 0.15, "time_constant")),
    "sensor-delay:q": _same_name("sensor-delay:q", uniform(0.03, 0.12, "delay"), channels=NZ),
    "sensor-delay:nz": _same_name("sensor-delay:nz", uniform(0.03, 0.12, "delay"), channels=NZ),
    "sensor-drift:q": _same_name("sensor-drift:q", signed(0.0003, 0.002, "slope"), apart=True),
    "sensor-drift:alpha": _same_name(
        "sensor-drift:alpha", signed(0.0003, 0.002, "slope"), apart=True
    ),
    "sensor-step:alpha": _zero_step("alpha"),
    "sensor-step:q": _zero_step("q"),
    "sensor-spikes:q": _same_name("sensor-spikes:q", uniform(0.03, 0.1, "size")),
}
