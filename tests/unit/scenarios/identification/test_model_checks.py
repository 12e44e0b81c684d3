"""What an own model is asked before there is a record: the example's bounds against sensitivities
written out, steps of integration.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.stats import kstest

from ident.flying_qualities.levels import FlightPhase, mode_levels
from ident.flying_qualities.modes import lateral_modes
from scenarios.identification.identify import identify
from scenarios.identification.model_checks import (
    DOUBLET_ANGLE,
    NOISE_SHARE,
    PULSE_LENGTH_FACTOR,
    STEPS_PER_PULSE,
    excited,
    one_by_one,
    steps_against_differences,
    unknown_units,
)
from scenarios.preparation.declared_model import sub_step
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.record import Channel, Hold, Record
from sim.truth.flight import fly, sample_times
from tests.bases import rigid_model
from tests.own_models import roll
from tests.whole_axes import DURATION, NOISE, RATE, TRUE, maneuvers, true_model, vehicle_file

A, B = -2.0, 8.0


def first_order(**changes: Any) -> Model:
    """x_dot = a x + b u, x measured with a bias."""
    declared: dict[str, Any] = {
        "name": "first order",
        "states": {"x": "m"},
        "inputs": {"u": "rad"},
        "outputs": {"x": "m"},
        "parameters": {"a": (A, "1/s"), "b": (B, "m/(s rad)")},
        "rates": lambda s, p: {"x": p.a * s.x + p.b * s.u},
        "readings": lambda s, p: {"x": s.x},
    }
    return own_model(**{**declared, **changes})


def test_bounds_of_the_example_are_those_of_its_sensitivities() -> None:
    motion, found = excited(first_order())
    pulse = PULSE_LENGTH_FACTOR / -A
    assert motion.pulse == pytest.approx(pulse, rel=1e-12) and motion.amplitudes == {
        "u": DOUBLET_ANGLE
    }
    # States: x, its slopes by a, b and its start; the slope by the bias is one.
    step = pulse / STEPS_PER_PULSE
    F = np.array([[A, 0, 0, 0], [1, A, 0, 0], [0, 0, A, 0], [0, 0, 0, A]])
    G = np.array([B, 0, 1, 0])
    E = expm(np.block([[F, G[:, None]], [np.zeros((1, 5))]]) * step)
    x, rows = np.array([0.0, 0.0, 0.0, 1.0]), []
    for k in range(round(motion.end / step)):
        rows.append(x)
        at = (k + 0.5) / STEPS_PER_PULSE - 1.0
        x = E[:4, :4] @ x + E[:4, 4] * DOUBLET_ANGLE * ((0 <= at < 1) - (1 <= at < 2))
    along = np.array(rows)
    slopes = np.column_stack([along[:, 1], along[:, 2], along[:, 3], np.ones(len(along))])
    noise = NOISE_SHARE * np.max(np.abs(along[:, 0]))
    sigmas = noise * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    assert [one.sigma for one in found] == pytest.approx(sigmas[:2], rel=1e-4)


def test_what_others_make_up_for_is_named() -> None:
    model = first_order(
        parameters={"a": (A, "1/s"), "b": (B, "1/s"), "gain": (1.0, "1"), "idle": (1.0, "1")},
        rates=lambda s, p: {"x": p.a * s.x + p.gain * p.b * s.u},
    )
    found = {one.name: one for one in excited(model)[1]}
    assert (
        found["a"].sigma < 0.1 and found["b"].beside == ("gain",) and found["gain"].beside == ("b",)
    )
    assert found["idle"].beside == () and not np.isfinite(found["idle"].sigma)


def test_arrays_steps_and_units_of_a_sound_model() -> None:
    assert (
        one_by_one(roll()) == 0.0
        and steps_against_differences(roll()) < 1e-8
        and unknown_units(roll()) == []
    )
    assert unknown_units(first_order(inputs={"u": "parsnips"})) == ["u (parsnips)"]


def test_a_function_that_mixes_runs_shows() -> None:
    def rates(s: Any, p: Any) -> dict[str, Any]:
        return {"x": p.a * s.x + p.b * s.u + 0.1 * (s.x - np.mean(s.x))}

    assert one_by_one(first_order(rates=rates)) > 1e-3


@pytest.mark.parametrize(
    ("interval", "root", "step"),
    [
        (0.02, 2.0, 0.01),
        (0.02, 150.0, 1e-3),
        (60.0, 1e-3, 60.0),
        (60.0, 1e-2, 15.0),
        (1e-4, 100.0, 1e-4),
    ],
)
def test_steps_follow_the_motion(interval: float, root: float, step: float) -> None:
    time = interval * np.arange(50)
    record = Record(
        time,
        (Channel.of("u", "rad", np.zeros(50)),),
        (Channel.of("x", "m", np.zeros(50)),),
        Hold.PREVIOUS,
        "record",
    )
    model = first_order(parameters={"a": (-root, "1/s"), "b": (B, "1/s")})
    # Where samples are finer than the usual step they are the step: the grid has one between two
    # samples at least.
    assert min(sub_step(model, [record], 0.01), interval) == pytest.approx(step, rel=1e-12)
    assert sub_step(rigid_model(), [record], 0.01) == 0.01


LIMIT = 0.19  # damping ratio of level 1, class I, category A


@pytest.mark.slow
def test_at_a_limit_every_probability_is_as_likely() -> None:
    """Forty records of a Dutch roll with the damping that level 1 asks, identified from starts 10 %
    off.
    """
    declared = true_model("lateral")
    system = compile_model(declared)
    at = system.parameters.index("Cn_r")

    def above(yaw_damping: float) -> float:
        p = system.parameters.values()
        p[at] = yaw_damping
        return lateral_modes(system, p)["dutch_roll_damping"] - LIMIT

    true = declared.with_values(
        {"Cn_r": brentq(above, 2.0 * TRUE["lateral"]["Cn_r"], 0.0, xtol=1e-12)}
    )
    true = replace(true, noise=Noise(dict(NOISE["lateral"])))
    shares = []
    for seed in range(40):
        record, _ = fly(
            true,
            maneuvers("lateral"),
            sample_times(RATE, DURATION["lateral"]),
            np.random.default_rng(seed),
            step=0.01,
            name="lateral.csv",
        )
        found = identify(record, vehicle_file("lateral", 1.1), "output-error")
        assert found.modes is not None
        dutch_roll = next(
            level
            for level in mode_levels(found.modes, FlightPhase("I", "A", ()))
            if level.mode == "Dutch roll"
        )
        shares.append(dutch_roll.probabilities[0])
    # A true null falls below once in a thousand times.
    assert kstest(shares, "uniform").pvalue > 1e-3, np.sort(shares)
