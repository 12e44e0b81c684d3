"""Grids on even, uneven and broken time bases, and the inputs that the vehicle gets on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, InputEffect, Parameter, Regularity, Station
from sim.declaration.model import System
from sim.effects.input_path.input_delay import InputDelay
from sim.propagation import (
    INPUT_CELL_TIME,
    cell_edges,
    drive_from_cells,
    drive_from_means,
    drive_from_record,
    make_grid,
)
from sim.record import Hold
from tests.bases import rigid_model

gaps = st.lists(
    st.sampled_from([0.02, 0.02, 0.02, 0.005, 0.033, 0.4, 3.0]), min_size=1, max_size=40
)
max_steps = st.sampled_from([0.005, 0.01, 0.02, 0.05])


@dataclass(frozen=True)
class Gain:
    """An input effect without memory, for these tests."""

    signal: str = "elevator"
    name: ClassVar[str] = "input-gain"
    station: ClassVar[Station] = Station.INPUT_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("gain", 2.0),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gain": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "u -> gain u"

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        assert len(edges) == len(u) + 1 and np.all(np.diff(edges) > 0)
        return p.gain * u


def systems(*effects: Effect) -> tuple[System, list[float]]:
    system = compile_model(rigid_model().with_effects(*effects))
    return system, [float(value) for value in system.parameters.values()]


def test_the_toy_effect_is_one() -> None:
    assert isinstance(Gain(), InputEffect)


@given(gaps, max_steps)
def test_samples_are_met_exactly_by_steps_that_are_short_enough(
    gaps: list[float], max_step: float
) -> None:
    time = 7.0 + np.concatenate([[0.0], np.cumsum(gaps)])
    grid = make_grid(time, max_step)
    np.testing.assert_array_equal(grid.edges[grid.sample], time)
    np.testing.assert_array_equal(grid.edges[:: grid.substeps], grid.nodes)
    assert (
        len(grid.steps)
        == len(grid.source)
        == len(grid.edges) - 1
        == (len(grid.nodes) - 1) * grid.substeps
    )
    np.testing.assert_allclose(np.diff(grid.edges), grid.steps, rtol=1e-9)
    assert grid.steps.max() <= max_step * (1.0 + 1e-5)
    # Nodes are put into gaps only, so that no interval is much longer than the usual one.
    assert np.diff(grid.nodes).max() <= 1.5 * max(float(np.median(np.diff(time))), max_step) * (
        1.0 + 1e-6
    )
    middle = 0.5 * (grid.edges[:-1] + grid.edges[1:])
    np.testing.assert_array_equal(grid.source, np.searchsorted(time, middle, side="right") - 1)


def test_even_sampling_has_one_node_a_sample() -> None:
    grid = make_grid(np.arange(11) * 0.02, 0.01)
    assert (len(grid.nodes), grid.substeps) == (11, 2)
    assert make_grid(np.arange(11) * 0.02, 0.02).substeps == 1
    assert (
        make_grid(np.array([0.0, 5.0]), 0.01).substeps
        * (len(make_grid(np.array([0.0, 5.0]), 0.01).nodes) - 1)
        == 500
    )


@given(gaps, max_steps)
def test_held_inputs_are_those_of_the_last_sample(gaps: list[float], max_step: float) -> None:
    time = np.concatenate([[0.0], np.cumsum(gaps)])
    u = np.arange(1.0, len(time) + 1.0)[None]
    system, p = systems()
    grid = make_grid(time, max_step)
    drive = drive_from_record(system, p, u, time, Hold.PREVIOUS, grid)
    for stage in drive.stages:
        np.testing.assert_array_equal(stage[0], u[0, grid.source])
    np.testing.assert_array_equal(drive.begin[0][grid.sample], u[0])
    np.testing.assert_array_equal(drive.end[0][grid.sample[1:] - 1], u[0, :-1])


@given(gaps, max_steps)
def test_linear_inputs_are_exact_at_every_stage(gaps: list[float], max_step: float) -> None:
    time = np.concatenate([[0.0], np.cumsum(gaps)])
    u = np.random.default_rng(len(gaps)).standard_normal((1, len(time)))
    system, p = systems()
    grid = make_grid(time, max_step)
    drive = drive_from_record(system, p, u, time, Hold.LINEAR, grid)
    wanted = (grid.edges[:-1], 0.5 * (grid.edges[:-1] + grid.edges[1:]), grid.edges[1:])
    for stage, t in zip(drive.stages, wanted, strict=True):
        np.testing.assert_allclose(stage[0], np.interp(t, time, u[0]), atol=1e-12)
    np.testing.assert_array_equal(drive.begin[0][grid.sample], u[0])
    np.testing.assert_array_equal(drive.end[0], drive.begin[0][1:])


@given(gaps)
def test_cells_subdivide_sub_steps(gaps: list[float]) -> None:
    grid = make_grid(np.concatenate([[0.0], np.cumsum(gaps)]), 0.01)
    edges = cell_edges(grid)
    per_step = (len(edges) - 1) // len(grid.edges)
    np.testing.assert_array_equal(edges[:-1:per_step], grid.edges)
    assert np.all(np.diff(edges) > 0) and np.diff(edges).max() <= INPUT_CELL_TIME * (1.0 + 1e-5)


def test_an_effect_without_memory_acts_on_every_value() -> None:
    time = np.cumsum([0.0, 0.02, 0.02, 0.3, 0.013, 0.02])
    u = np.random.default_rng(1).standard_normal((1, 6))
    grid = make_grid(time, 0.01)
    (plain_system, plain_p), (system, p) = systems(), systems(Gain())
    plain, doubled = (
        drive_from_record(s, v, u, time, Hold.PREVIOUS, grid)
        for s, v in ((plain_system, plain_p), (system, p))
    )
    for a, b in zip(
        [*plain.stages, plain.begin, plain.end],
        [*doubled.stages, doubled.begin, doubled.end],
        strict=True,
    ):
        np.testing.assert_array_equal(b[0], 2.0 * a[0])
    plain, doubled = (
        drive_from_record(s, v, u, time, Hold.LINEAR, grid)
        for s, v in ((plain_system, plain_p), (system, p))
    )
    # What the effect changes in a linear input enters as a mean, over a sub-step or, at a sample,
    # over a cell.
    np.testing.assert_allclose(doubled.stages[1][0], 2.0 * plain.stages[1][0], atol=1e-12)
    slope = np.abs(np.diff(u) / np.diff(time)).max()
    np.testing.assert_allclose(
        doubled.begin[0], 2.0 * plain.begin[0], atol=0.5 * INPUT_CELL_TIME * slope
    )


def test_a_delay_moves_the_switch_of_a_held_input_exactly() -> None:
    time = np.arange(51) * 0.02
    u = (time >= 0.2 - 1e-9)[None] * 1.0
    grid = make_grid(time, 0.01)
    system, p = systems(InputDelay())
    p[system.parameters.index("input-delay.delay")] = 0.063
    drive = drive_from_record(system, p, u, time, Hold.PREVIOUS, grid)
    # The switch lies 0.3 into the sub-step that begins at 0.26 s: 0.7 of it have the new value.
    np.testing.assert_allclose(drive.stages[0][0][25:28], [0.0, 0.7, 1.0], atol=1e-12)
    np.testing.assert_allclose(drive.end[0][25:28], [0.0, 1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(drive.begin[0][26:28], [0.0, 1.0], atol=1e-12)


def test_a_delayed_linear_input_is_the_shifted_line() -> None:
    time = np.arange(51) * 0.02
    grid = make_grid(time, 0.01)
    system, p = systems(InputDelay())
    p[system.parameters.index("input-delay.delay")] = 0.1
    drive = drive_from_record(system, p, 3.0 * time[None], time, Hold.LINEAR, grid)
    late = grid.edges > 0.12
    np.testing.assert_allclose(drive.begin[0][late], 3.0 * (grid.edges[late] - 0.1), atol=1e-11)
    np.testing.assert_allclose(
        drive.stages[1][0][late[:-1]],
        3.0 * (grid.edges[:-1][late[:-1]] + 0.5 * grid.steps[0] - 0.1),
        atol=1e-11,
    )


def test_batches_of_delays_drive_one_by_one() -> None:
    time = np.arange(26) * 0.02
    u = np.random.default_rng(2).standard_normal((1, 26))
    grid = make_grid(time, 0.01)
    system, p = systems(InputDelay())
    at, delays = system.parameters.index("input-delay.delay"), np.array([0.0, 0.033, 0.1])
    for hold in Hold:
        batch: list[Any] = list(p)
        batch[at] = delays
        together = drive_from_record(system, batch, u, time, hold, grid)
        for i, delay in enumerate(delays):
            p[at] = float(delay)
            alone = drive_from_record(system, p, u, time, hold, grid)
            for a, b in zip(
                [*together.stages, together.begin, together.end],
                [*alone.stages, alone.begin, alone.end],
                strict=True,
            ):
                np.testing.assert_allclose(a[0][:, i], b[0], rtol=1e-13, atol=1e-14)


def test_cells_and_means_may_be_given_directly() -> None:
    grid = make_grid(np.arange(4) * 0.02, 0.01)
    edges = cell_edges(grid)
    system, p = systems()
    cells = np.sin(edges[:-1])
    drive = drive_from_cells(system, p, [cells], edges, grid)
    by_step = cells.reshape(len(grid.edges), -1)
    np.testing.assert_allclose(drive.stages[0][0], by_step[:-1].mean(axis=1), rtol=1e-14)
    np.testing.assert_array_equal(drive.begin[0], by_step[:, 0])
    np.testing.assert_array_equal(drive.end[0], by_step[:-1, -1])
    given_means = drive_from_means([by_step[:-1, 0]], [by_step[:, 0]], [by_step[:-1, -1]])
    assert given_means.stages[0] is given_means.stages[2]
