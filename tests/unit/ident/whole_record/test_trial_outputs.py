"""Outputs under trial parameters, all at once, against one simulation each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from ident.whole_record.record_problem import record_problem
from ident.whole_record.trial_outputs import trial_outputs
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import System
from sim.effects.library import find_effect
from sim.propagation import drive_from_record, make_grid, propagate, simulate
from sim.record import Record
from sim.vehicles.uncoupled import ShortPeriod
from tests.bases import rigid_model
from tests.tracing_problem import doublets, planted

STEP = 0.01
X0 = np.array([0.01, -0.02])


def effect_named(name: str) -> Effect:
    return find_effect(name, ShortPeriod())


@pytest.fixture(scope="module")
def record() -> Record:
    return planted(flight=doublets(4.0))


def brute(system: System, record: Record, p: np.ndarray) -> np.ndarray:
    """One sequential simulation, ``(m, N)``."""
    grid = make_grid(record.time, STEP)
    x0 = [*X0.tolist(), *[0.0] * (len(system.states) - 2)]
    drive = drive_from_record(
        system, p.tolist(), record.input_array(system.input_names), record.time, record.hold, grid
    )
    return np.array(simulate(system, p.tolist(), x0, drive, grid))


def compared(
    record: Record, effects: Sequence[Effect], columns: Sequence[Mapping[str, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Base and trials by the function, then by simulation: ``(m, N)``, ``(m, N, a)``
    twice.
    """
    system = compile_model(rigid_model().with_effects(*effects))
    problem = record_problem(record, system, STEP, (), ())
    base = system.parameters.values()
    for effect in effects:
        for local, value in effect.absent.items():
            base[system.parameters.index(full_name(effect, local))] = value
    grid = problem.grid
    drive = drive_from_record(
        system,
        base.tolist(),
        record.input_array(system.input_names),
        record.time,
        record.hold,
        grid,
    )
    path = np.array(
        propagate(
            system, base.tolist(), [*X0.tolist(), *[0.0] * (len(system.states) - 2)], drive, grid
        )
    )[:, :: grid.substeps]
    path[2:] = 0.0
    trials = np.repeat(base[:, None], len(columns), axis=1)
    for a, values in enumerate(columns):
        for name, value in values.items():
            trials[system.parameters.index(name), a] = value
    y, changed = trial_outputs(problem, base, path, trials, 2)
    return (
        y,
        changed,
        brute(system, record, base),
        np.stack([brute(system, record, trials[:, a]) for a in range(len(columns))], axis=2),
    )


EXACT = [
    (("input-delay",), [{"input-delay.delay": d} for d in (0.013, 0.05, 0.2)]),
    (("actuator-lag",), [{"actuator-lag.time_constant": d} for d in (0.013, 0.2)]),
    (("sensor-lag:q",), [{"sensor-lag:q.time_constant": d} for d in (0.013, 0.05, 0.2)]),
    (("sensor-delay:alpha",), [{"sensor-delay:alpha.delay": d} for d in (0.013, 0.2)]),
    (("sensor-scale:nz",), [{"sensor-scale:nz.scale": d} for d in (0.7, 1.4)]),
    (("sensor-drift:q",), [{"sensor-drift:q.slope": d} for d in (-0.01, 0.02)]),
    (
        ("unmeasured-input",),
        [
            {
                "unmeasured-input.start": t,
                "unmeasured-input.duration": 0.7,
                "unmeasured-input.moment": 0.01,
            }
            for t in (0.5, 2.2)
        ],
    ),
    # Driven by the control alone an oscillator feeds nothing back to itself, whatever its size and
    # frequency.
    (
        ("elastic-mode",),
        [
            {
                f"elastic-mode.{name}": value
                for name, value in zip(("frequency", "lift", "moment", "gyro"), values, strict=True)
            }
            for values in (
                (15.0, 0.3, -0.4, 0.0),
                (15.0, 0.0, 0.0, 0.03),
                (40.0, -0.2, 0.1, 0.02),
                (7.0, 0.2, 0.2, 0.0),
            )
        ],
    ),
    # Stations together.
    (
        ("input-delay", "sensor-lag:q", "unmeasured-input"),
        [
            {
                "input-delay.delay": 0.08,
                "sensor-lag:q.time_constant": 0.06,
                "unmeasured-input.moment": 0.004,
            },
            {"sensor-lag:q.time_constant": 0.1, "unmeasured-input.lift": 0.02},
            {"input-delay.delay": 0.021},
        ],
    ),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("names", "columns"), EXACT, ids=["+".join(names) for names, _ in EXACT])
def test_trials_equal_simulations_where_transitions_are_those_of_the_base(
    record: Record, names: tuple[str, ...], columns: list[dict[str, float]]
) -> None:
    y, changed, base, simulated = compared(record, [effect_named(name) for name in names], columns)
    size = np.ptp(base, axis=1)
    assert np.max(np.abs(y - base) / size[:, None]) < 1e-12
    assert np.max(np.abs(changed - simulated) / size[:, None, None]) < 1e-8
    visible = np.max(np.abs(simulated - base[:, :, None]) / size[:, None, None], axis=(0, 1))
    assert np.all(visible > 1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("elastic-mode", {"frequency": 15.0, "lift": 0.4, "moment": -0.3, "angle_gain": 1.5}),
        ("derivative-jump", {"time": 1.3, "Cm_alpha": 0.4, "Cm_de": -0.5}),
        ("speed-variation", {"rate": 0.4}),
    ],
)
def test_what_feeds_back_is_first_order(
    record: Record, name: str, values: dict[str, float]
) -> None:
    """The change is right to first order: a size ten times smaller has a relative error ten times
    smaller.
    """
    effect = effect_named(name)
    values = {**dict(effect.absent), **values}
    error = []
    for size in (1.0, 0.1, 0.01):
        column = {
            full_name(effect, local): value * (size if local in effect.absent else 1.0)
            for local, value in values.items()
        }
        _, changed, base, simulated = compared(record, [effect], [column])
        error.append(
            float(
                np.linalg.norm(changed - simulated) / np.linalg.norm(simulated - base[:, :, None])
            )
        )
    assert error[1] == pytest.approx(0.1 * error[0], rel=0.35)
    assert error[2] == pytest.approx(0.1 * error[1], rel=0.1)
    assert error[2] < 0.01


def test_a_column_does_not_depend_on_its_neighbours(record: Record) -> None:
    columns = [
        {"elastic-mode.frequency": f, "elastic-mode.moment": 0.2, "elastic-mode.angle_gain": 1.0}
        for f in (9.0, 21.0, 9.0)
    ]
    _, together, _, _ = compared(record, [effect_named("elastic-mode")], columns)
    for a, column in enumerate(columns):
        _, alone, _, _ = compared(record, [effect_named("elastic-mode")], [column])
        np.testing.assert_allclose(together[:, :, a], alone[:, :, 0], rtol=0, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["elastic-mode", "input-delay", "sensor-lag:q"])
def test_trials_a_few_at_a_time_are_those_of_one_batch(
    monkeypatch: pytest.MonkeyPatch, record: Record, name: str
) -> None:
    effect = effect_named(name)
    first = {"elastic-mode": "frequency", "input-delay": "delay", "sensor-lag:q": "time_constant"}[
        name
    ]
    columns = [
        {full_name(effect, first): value}
        for value in ((9.0, 21.0, 9.0) if name == "elastic-mode" else (0.02, 0.05, 0.11))
    ]
    columns = [
        {**column, **({full_name(effect, "moment"): 0.2} if name == "elastic-mode" else {})}
        for column in columns
    ]
    y, together, _, _ = compared(record, [effect], columns)
    monkeypatch.setattr("ident.whole_record.trial_outputs._LARGEST_BATCH", 1)
    base, one_by_one, _, _ = compared(record, [effect], columns)
    np.testing.assert_allclose(one_by_one, together, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(base, y)
