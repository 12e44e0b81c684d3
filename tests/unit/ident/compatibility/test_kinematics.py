"""The kinematic relations against a flight by Newton's law in body axes; the noise model against
dense matrices.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.compatibility.fitting import fit
from ident.compatibility.kinematics import SensorFault, evaluate, linearised, start_of, unknowns_of
from ident.compatibility.signals import (
    KinematicSignals,
    RelationNoise,
    relations,
    signals_of,
    smoothed_walk,
    walk_gains,
    whitener,
)
from tests.oracles.flight_path import Sensors
from tests.unit.ident.compatibility.flights import ALL, FOUR, SPEED, THREE, record

CLOSE = {"alpha": 2e-4, "theta": 5e-5, "airspeed": 0.02}


@pytest.mark.parametrize("channels", [THREE, FOUR, ALL])
def test_a_true_flight_is_reconstructed(channels: tuple[str, ...]) -> None:
    s = signals_of(record(channels, rate=100.0, noise=1e-4), channels, SPEED, 9.80665)
    found = fit([s])
    for name, residual in zip(s.outputs, found.residuals[0], strict=True):
        # Without ax the load along z stands for that normal to the path, which costs some of alpha.
        assert np.abs(residual).max() < CLOSE[name] * (
            10.0 if name == "alpha" and "ax" not in channels else 1.0
        )


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("fault", "sensors", "size"),
    [
        (SensorFault("alpha", "delay"), Sensors(delay={"alpha": 0.07}), 0.07),
        (SensorFault("alpha", "lag"), Sensors(lag={"alpha": 0.07}), 0.07),
        (SensorFault("alpha", "arm"), Sensors(arm=7.0), 7.0),
        (SensorFault("alpha", "scale"), Sensors(scale={"alpha": 1.1}), 0.1),
        (SensorFault("q", "delay"), Sensors(delay={"q": 0.07}), 0.07),
        (SensorFault("q", "lag"), Sensors(lag={"q": 0.07}), 0.07),
        (SensorFault("nz", "delay"), Sensors(delay={"nz": 0.07}), 0.07),
        (SensorFault("nz", "lag"), Sensors(lag={"nz": 0.07}), 0.07),
        (SensorFault("theta", "delay"), Sensors(delay={"theta": 0.07}), 0.07),
        (SensorFault("airspeed", "delay"), Sensors(delay={"airspeed": 0.07}), 0.07),
        (SensorFault("ax", "scale"), Sensors(scale={"ax": 1.1}), 0.1),
        (SensorFault("theta", "drift"), Sensors(drift={"theta": 1e-3}), 1e-3),
    ],
    ids=lambda value: value.name if isinstance(value, SensorFault) else "",
)
def test_a_fault_is_found_in_its_true_size(
    fault: SensorFault, sensors: Sensors, size: float
) -> None:
    s = signals_of(record(ALL, sensors, rate=50.0, noise=1e-3), ALL, SPEED, 9.80665)
    found = fit([s], [fault], fit([s]))
    assert found.sizes[0] == pytest.approx(size, rel=0.04)


@pytest.mark.sampled
@pytest.mark.parametrize(("kind", "size"), [("scale", -0.2), ("delay", 0.12), ("lag", 0.12)])
def test_the_arm_of_the_vane_multiplies_the_true_pitch_rate(kind: str, size: float) -> None:
    faulty = (
        Sensors(arm=12.0, scale={"q": 1.0 + size})
        if kind == "scale"
        else Sensors(arm=12.0, **{kind: {"q": size}})
    )
    s = signals_of(record(ALL, faulty, rate=50.0, noise=1e-3), ALL, SPEED, 9.80665)
    found = fit([s], [SensorFault("q", kind), SensorFault("alpha", "arm")], fit([s]))
    assert found.sizes == pytest.approx([size, 12.0], rel=0.02)


@pytest.mark.long
@settings(max_examples=25)
@given(
    st.sampled_from(["scale", "delay", "lag", "drift", "bias"]),
    st.sampled_from(ALL),
    st.floats(0.001, 0.04),
)
def test_a_fault_of_size_zero_changes_nothing_and_the_slope_is_that_of_small_sizes(
    kind: str, channel: str, size: float
) -> None:
    s = signals_of(record(ALL), ALL, SPEED, 9.80665)
    unknowns, fault = unknowns_of(s), SensorFault(channel, kind)
    unknown_values = start_of(s, unknowns)
    plain = evaluate(s, unknowns, (), unknown_values[None], np.zeros((1, 0)))
    assert np.array_equal(
        evaluate(s, unknowns, (fault,), unknown_values[None], np.zeros((1, 1))), plain
    )
    small = 0.1 * size * fault.plausible
    _, slope = linearised(s, unknowns, (fault,), unknown_values, np.array([small]))
    step = evaluate(
        s,
        unknowns,
        (fault,),
        np.array([unknown_values, unknown_values]),
        np.array([[small + 0.003], [small - 0.003]]),
    )
    assert slope[:, :, -1] == pytest.approx(
        (step[:, 0] - step[:, 1]) / 0.006,
        rel=0.2,
        abs=0.02 * float(np.abs(slope[:, :, -1]).max()) + 1e-9,
    )


def dense(s: KinematicSignals, noise: RelationNoise) -> np.ndarray:
    """Covariance of the residual, samples of one time beside each other: white noise and the sums
    of what the inputs added so far.
    """
    m, n = s.valid.shape
    gains = walk_gains(s, noise)
    step = gains @ np.diag(noise.density) @ gains.T
    out = np.kron(np.eye(n), np.diag(noise.white))
    since = np.concatenate([[0.0], np.cumsum(s.steps**2)])
    for i in range(n):
        for j in range(n):
            out[i * m : i * m + m, j * m : j * m + m] += step * min(since[i], since[j])
    return out


@pytest.mark.parametrize("channels", [THREE, FOUR, ALL])
def test_whitening_and_smoothing_are_those_of_the_dense_covariance(
    channels: tuple[str, ...],
) -> None:
    s = signals_of(record(channels).window(3.0, 4.5), channels, SPEED, 9.80665)
    m, n = s.valid.shape
    rng = np.random.default_rng(4)
    begun = fit([s]).noise
    noise = RelationNoise(begun.outputs, begun.inputs, begun.white * 2.0, begun.density * 300.0)
    s = KinematicSignals(
        s.name,
        s.time,
        s.channels,
        s.outputs,
        np.ones_like(s.valid),
        s.speed,
        s.gravity,
        s.vane_arm,
        s.jumps,
        s.spikes,
    )
    r = rng.standard_normal((m, n)) * np.sqrt(noise.white)[:, None]
    S, flat = dense(s, noise), r.T.ravel()
    white = whitener(s, noise)
    assert float(np.sum(white(r[:, :, None]) ** 2)) == pytest.approx(
        float(flat @ np.linalg.solve(S, flat)), rel=1e-9
    )
    assert white.log_determinant == pytest.approx(float(np.linalg.slogdet(S)[1]), rel=1e-9)
    expected = flat - np.tile(noise.white, n) * np.linalg.solve(S, flat)
    assert smoothed_walk(s, noise, r).T.ravel() == pytest.approx(
        expected, abs=1e-8 * float(np.abs(r).max())
    )


def test_whitening_no_columns_is_no_work() -> None:
    """SciPy's triangular solve corrupts memory where there is no right-hand side."""
    s = signals_of(record(FOUR).window(3.0, 4.5), FOUR, SPEED, 9.80665)
    none = np.empty((*s.valid.shape, 0))
    assert whitener(s, fit([s]).noise)(none).shape == none.shape


def test_a_missing_sample_says_nothing() -> None:
    s = signals_of(record(FOUR).window(3.0, 4.5), FOUR, SPEED, 9.80665)
    noise, rng = fit([s]).noise, np.random.default_rng(5)
    valid = rng.random(s.valid.shape) < 0.7
    holed = KinematicSignals(
        s.name,
        s.time,
        s.channels,
        s.outputs,
        valid,
        s.speed,
        s.gravity,
        s.vane_arm,
        s.jumps,
        s.spikes,
    )
    r = np.where(valid, rng.standard_normal(valid.shape) * np.sqrt(noise.white)[:, None], 0.0)
    keep = valid.T.ravel()
    S, flat = dense(s, noise)[np.ix_(keep, keep)], r.T.ravel()[keep]
    white = whitener(holed, noise)
    assert float(np.sum(white(r[:, :, None]) ** 2)) == pytest.approx(
        float(flat @ np.linalg.solve(S, flat)), rel=1e-5
    )
    assert white.log_determinant == pytest.approx(float(np.linalg.slogdet(S)[1]), abs=1e-3)


def test_relations_are_those_that_the_channels_close() -> None:
    assert relations(("alpha", "q")) == {}
    assert (
        set(relations(THREE)) == {"alpha"}
        and set(relations(FOUR)) == {"alpha", "theta"}
        and set(relations(ALL)) == {"alpha", "theta", "airspeed"}
    )
    assert set(relations(("q", "theta"))) == {"theta"}
