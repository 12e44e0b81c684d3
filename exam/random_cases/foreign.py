"""Causes that no effect of the library names: the right answer is `unexplained`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exam.random_cases.case import Draw, Kind, Setting
from exam.random_cases.sizes import either, several, signed, uniform

BALLISTIC = ("ballistic",)


def _in_moment(draw: Draw, local: str) -> Draw:
    """Sizes said in coefficients, taken to the moment of the equations at hand."""

    def scaled(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
        values = draw(rng, s)
        return {**values, local: values[local] * s.moment}

    return scaled


def _product(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "moment": either(rng) * float(rng.uniform(4.0, 9.0)) * s.moment / s.control,
        "lift": -2.0 * s.lift / s.control,
    }


def _lagged(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    values = several(rng, moment=(-0.5, -0.2), lift=(0.5, 2.0), fast=(0.15, 0.5), slow=(0.8, 2.5))
    return {**values, "moment": values["moment"] * s.moment, "lift": values["lift"] * s.lift}


def _upwash(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"gain": either(rng) * float(rng.uniform(0.06, 0.2)) / s.control}


# A moment that is a function of the pitch rate is a damping that depends on it, word for word; so
# is one by a product of two signals a derivative that grows with the other: the general form names
# them.
OF_THE_RATE = ("varies:Cm_q(q)", "varies:M_q(q)")
OF_BOTH = ("varies:Cm_q(alpha)", "varies:M_q(alpha)", "varies:Cm_alpha(q)", "varies:M_alpha(q)")

FOREIGN: Mapping[str, Kind] = {
    "product": Kind(_product, "own:alpha-control-product"),
    "periodic": Kind(
        _in_moment(lambda rng, s: several(rng, size=(0.002, 0.006), frequency=(3.0, 8.0)), "size"),
        "own:periodic-moment",
    ),
    "rate damping": Kind(
        _in_moment(lambda rng, s: several(rng, size=(-0.9, -0.3)), "size"),
        "own:rate-damping",
        accepted=OF_THE_RATE,
    ),
    "lagged loads": Kind(_lagged, "own:lagged-loads"),
    "hysteresis": Kind(
        _in_moment(lambda rng, s: several(rng, size=(-0.015, -0.005), width=(0.02, 0.04)), "size"),
        "own:hysteresis",
    ),
    "friction": Kind(
        _in_moment(lambda rng, s: several(rng, size=(0.003, 0.008), width=(0.005, 0.02)), "size"),
        "own:friction",
        accepted=OF_THE_RATE,
    ),
    "alpha-rate product": Kind(
        _in_moment(signed(0.8, 2.0, "moment"), "moment"), "own:alpha-rate-product", accepted=OF_BOTH
    ),
    "travelling mass": Kind(
        _in_moment(signed(0.012, 0.025, "rate"), "rate"), "own:travelling-mass"
    ),
    "control upwash": Kind(_upwash, "own:control-upwash"),
    # Named as a curved calibration it is found: the library has no other form of that.
    "cubic vane": Kind(
        uniform(30.0, 80.0, "cubic"),
        "own:cubic-vane",
        channels=("nz",),
        accepted=("sensor-curve:alpha",),
    ),
    "drag rhythm": Kind(
        lambda rng, s: several(rng, size=(0.15, 0.4), frequency=(0.8, 2.5)),
        "own:drag-rhythm",
        models=BALLISTIC,
    ),
    "drag decay": Kind(signed(0.01, 0.03, "rate"), "own:drag-decay", models=BALLISTIC),
    "density layer": Kind(
        lambda rng, s: several(rng, size=(0.2, 0.5), middle=(13e3, 24e3), depth=(1500.0, 3000.0)),
        "own:density-layer",
        models=BALLISTIC,
    ),
}
