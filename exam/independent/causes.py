"""Causes that are added to true signals, with the effect names that are right answers; written from
the definitions of the effects in words.

They act on signals by channel name on a fine grid, before filters, sampling and noise, for any
simulator. A positive delay or lag makes a signal late, and a positive arm is ahead of the centre of
gravity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exam.independent.folders import SIGMA, Planted, Signals

G0 = 9.80665  # m/s2
Plant = Callable[[Signals, float], Signals]  # signals and the fine step (s) -> signals


@dataclass(frozen=True)
class Scales:
    """Scales of the sizes of causes: chord or a third of the span (m), and the time of the fast
    mode, 1/omega (s).
    """

    length: float
    time: float


@dataclass(frozen=True)
class Cause:
    """A hidden cause and its action on the signals."""

    planted: Planted
    plant: Plant


def shifted(values: np.ndarray, step: float, delay: float) -> np.ndarray:
    """Return the signal ``delay`` s late (early if negative), by linear interpolation; its ends
    repeat.
    """
    time = step * np.arange(len(values))
    return np.interp(time - delay, time, values)


def lagged(values: np.ndarray, step: float, lag: float) -> np.ndarray:
    """Return the signal behind a first-order lag of ``lag`` s. It is exact for signals that are
    linear between grid points, and begins at rest.
    """
    keep = np.exp(-step / lag)
    out = np.empty_like(values)
    out[0], behind = values[0], 0.0
    for k in range(1, len(values)):
        slope = (values[k] - values[k - 1]) / step
        behind = lag * slope + (behind - lag * slope) * keep
        out[k] = values[k] - behind
    return out


def with_play(values: np.ndarray, half_width: float) -> np.ndarray:
    """Return a follower with play, which moves only when the signal pushes it at ``half_width``."""
    out = np.empty_like(values)
    at = values[0]
    for k, value in enumerate(values):
        at = min(max(at, value - half_width), value + half_width)
        out[k] = at
    return out


def _on(channel: str, act: Callable[[np.ndarray, float], np.ndarray]) -> Plant:
    return lambda signals, step: {**signals, channel: act(signals[channel], step)}


_NEAR_LATE = {
    **{"alpha": ("vane-offset",), "beta": ("vane-offset",)},
    **{"nz": ("accelerometer-offset:nz",), "ny": ("accelerometer-offset:ny",)},
}


def _late_names(channel: str) -> tuple[str, ...]:
    return (f"sensor-delay:{channel}", f"sensor-lag:{channel}")


def late_sensor(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A sensor with a delay."""
    delay = float(rng.uniform(0.1, 0.25)) * min(scales.time, 0.4)
    delay = max(delay, 0.02)
    values = {f"sensor-delay:{channel}": {"delay": delay}}
    planted = Planted(
        f"late {channel}", _late_names(channel), _NEAR_LATE.get(channel, ()), (channel,), values
    )
    return Cause(planted, _on(channel, lambda v, step: shifted(v, step, delay)))


def lagging_sensor(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A sensor with a first-order lag."""
    lag = max(float(rng.uniform(0.12, 0.3)) * min(scales.time, 0.4), 0.03)
    values = {f"sensor-lag:{channel}": {"time_constant": lag}}
    planted = Planted(
        f"lagging {channel}", _late_names(channel), _NEAR_LATE.get(channel, ()), (channel,), values
    )
    return Cause(planted, _on(channel, lambda v, step: lagged(v, step, lag)))


def wrong_scale(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A scale factor with an error of 6 to 20 %; the value at the start is unchanged."""
    scale = 1.0 + float(rng.uniform(0.06, 0.2) * rng.choice([-1.0, 1.0]))
    name = f"sensor-scale:{channel}"
    near = ("sensor-coupling:q",) if channel == "nz" else ()
    planted = Planted(f"scale of {channel}", (name,), near, (channel,), {name: {"scale": scale}})
    return Cause(planted, _on(channel, lambda v, step: v[0] + scale * (v - v[0])))


def drifting(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A zero that drifts at a constant rate: 3 to 8 noise sigmas in 20 s."""
    slope = float(rng.uniform(3.0, 8.0) * rng.choice([-1.0, 1.0])) * SIGMA[channel] / 20.0
    name = f"sensor-drift:{channel}"
    planted = Planted(f"drift of {channel}", (name,), (), (channel,), {name: {"slope": slope}})
    return Cause(planted, _on(channel, lambda v, step: v + slope * step * np.arange(len(v))))


def zero_step(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A zero that jumps by 4 to 10 noise sigmas, at the same share of every record."""
    size, share = (
        float(rng.uniform(4.0, 10.0) * rng.choice([-1.0, 1.0])) * SIGMA[channel],
        float(rng.uniform(0.3, 0.7)),
    )
    name = f"sensor-step:{channel}"
    planted = Planted(f"zero step of {channel}", (name,), (), (channel,), {name: {"size": size}})
    return Cause(
        planted, _on(channel, lambda v, step: v + size * (np.arange(len(v)) >= share * len(v)))
    )


def held(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """Sample and hold at a low rate."""
    period = float(rng.uniform(0.08, 0.2))
    name = f"sensor-hold:{channel}"

    def act(values: np.ndarray, step: float) -> np.ndarray:
        time = step * np.arange(len(values))
        return np.interp(np.floor(time / period + 1e-9) * period, time, values)

    planted = Planted(
        f"held {channel}", (name,), _late_names(channel), (channel,), {name: {"period": period}}
    )
    return Cause(planted, _on(channel, act))


def curved(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A nonlinear calibration: an error of 15 to 40 % at 4 degrees from the start."""
    curvature = float(rng.uniform(0.15, 0.4) * rng.choice([-1.0, 1.0])) / float(np.radians(4.0))
    name = f"sensor-curve:{channel}"
    planted = Planted(
        f"curved {channel}", (name,), (), (channel,), {name: {"curvature": curvature}}
    )
    return Cause(planted, _on(channel, lambda v, step: v + curvature * (v - v[0]) ** 2))


def boom(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A vane on a boom ahead of the centre of gravity, which senses the rotation of the
    aircraft.
    """
    arm = float(rng.uniform(1.2, 3.0)) * scales.length
    about = "q" if channel == "alpha" else "r"

    def plant(signals: Signals, step: float) -> Signals:
        speed, angle = signals["airspeed"], signals[channel]
        along, across = speed * np.cos(angle), speed * np.sin(angle)
        across = across + (-arm if channel == "alpha" else arm) * signals[about]
        return {**signals, channel: np.arctan2(across, along)}

    near = (
        *_late_names(channel),
        "accelerometer-offset:nz" if channel == "alpha" else "accelerometer-offset:ny",
    )
    return Cause(
        Planted(
            f"{channel} vane ahead",
            ("vane-offset",),
            near,
            (channel,),
            {"vane-offset": {"arm": arm}},
        ),
        plant,
    )


def accelerometer_ahead(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """An accelerometer ahead of or behind the centre of gravity, which senses the angular
    acceleration.
    """
    arm = float(rng.uniform(0.8, 2.0) * rng.choice([-1.0, 1.0])) * scales.length
    about = "q" if channel == "nz" else "r"
    name = f"accelerometer-offset:{channel}"

    def plant(signals: Signals, step: float) -> Signals:
        return {**signals, channel: signals[channel] + arm / G0 * np.gradient(signals[about], step)}

    planted = Planted(
        f"{channel} accelerometer off the c.g.",
        (name,),
        ("vane-offset", *_late_names(channel)),
        (channel,),
        {name: {"arm": arm}},
    )
    return Cause(planted, plant)


def recorded_late(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """The input is recorded late."""
    delay = float(rng.uniform(0.04, 0.1))
    planted = Planted(
        f"{channel} recorded late",
        _inputs("input-recorded-late", channel),
        (),
        (channel,),
        _valued("input-recorded-late", channel, "delay", delay),
    )
    return Cause(planted, _on(channel, lambda v, step: shifted(v, step, delay)))


def follows_late(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """The surface follows the recorded input late."""
    delay = float(rng.uniform(0.04, 0.1))
    near = (*_inputs("actuator-lag", channel), *_inputs("actuator-second-order", channel))
    planted = Planted(
        f"{channel} follows late",
        _inputs("input-delay", channel),
        near,
        (channel,),
        _valued("input-delay", channel, "delay", delay),
    )
    return Cause(planted, _on(channel, lambda v, step: shifted(v, step, -delay)))


def _inputs(name: str, channel: str) -> tuple[str, ...]:
    """Return the names of an effect with and without the input's name; a model with one input has
    the name without it.
    """
    return (name, f"{name}:{channel}")


def _valued(name: str, channel: str, parameter: str, value: float) -> dict[str, dict[str, float]]:
    return {each: {parameter: value} for each in _inputs(name, channel)}


def feels_load(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A rate gyro that senses the load factor, 0.01 to 0.03 rad/s per g."""
    gain = float(rng.uniform(0.01, 0.03) * rng.choice([-1.0, 1.0]))

    def plant(signals: Signals, step: float) -> Signals:
        return {**signals, "q": signals["q"] + gain * (signals["nz"] - signals["nz"][0])}

    planted = Planted(
        "q feels nz",
        ("sensor-coupling:q",),
        ("sensor-scale:nz",),
        ("q",),
        {"sensor-coupling:q": {"gain": gain}},
    )
    return Cause(planted, plant)


def cross_axis(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A yaw gyro that is turned by a few degrees towards the roll axis."""
    share = float(rng.uniform(0.05, 0.12) * rng.choice([-1.0, 1.0]))
    name = "sensor-coupling:r"
    planted = Planted("p into r", (name,), (), ("r",), {name: {"share": share}})
    return Cause(
        planted, lambda signals, step: {**signals, "r": signals["r"] + share * signals["p"]}
    )


def vane_with_play(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A vane with play in its bearing."""
    width = float(np.radians(rng.uniform(0.25, 0.5)))
    name = f"sensor-backlash:{channel}"
    planted = Planted(
        f"play of the {channel} vane",
        (name,),
        (*_late_names(channel), f"sensor-curve:{channel}", "vane-offset"),
        (channel,),
        {name: {"half_width": width}},
    )
    return Cause(planted, _on(channel, lambda v, step: with_play(v, width)))


def gyro_threshold(channel: str, scales: Scales, rng: np.random.Generator) -> Cause:
    """A gyro with a threshold."""
    width = float(np.radians(rng.uniform(0.4, 0.9)))
    name = f"sensor-deadband:{channel}"
    near = (f"sensor-curve:{channel}",)
    planted = Planted(
        f"threshold of {channel}", (name,), near, (channel,), {name: {"half_width": width}}
    )
    return Cause(
        planted, _on(channel, lambda v, step: np.sign(v) * np.maximum(np.abs(v) - width, 0.0))
    )
